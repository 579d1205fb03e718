// Accurate normals in Unity: a component beside a SkinnedMeshRenderer. It runs the compute pass of skinbake over the
// vertices that Unity has skinned, so every material has the normals. Its tests compile it and run it with stand-ins
// for Unity's types. It has not run in Unity.
//
// Bake with --layout texcoord --frame tangent, import by UnityGLTF, and give the pass the text of
// skinbake shader --stage compute --lang hlsl --for FILE, below a line "#pragma kernel main". Blend shapes are left out.

using System.Collections.Generic;
using UnityEngine;
using UnityEngine.Rendering;

[RequireComponent(typeof(SkinnedMeshRenderer))]
public class Skinbake : MonoBehaviour
{
    public ComputeShader pass;

    struct Vertex
    {
        public Vector3 position, normal;
        public Vector4 tangent;
        public Vector2 uv0, uv1, uv2, uv3;
        public BoneWeight skin; // four weights, then four joints
    }

    const int Stride = 104; // of Vertex
    const int Absent = -1;

    SkinnedMeshRenderer skinned;
    GraphicsBuffer geometry, joints;

    void OnEnable()
    {
        skinned = GetComponent<SkinnedMeshRenderer>();
        skinned.vertexBufferTarget |= GraphicsBuffer.Target.Raw;
        Mesh mesh = skinned.sharedMesh;
        Vector3[] positions = mesh.vertices, normals = mesh.normals;
        Vector4[] tangents = mesh.tangents;
        Vector2[] uv0 = mesh.uv, uv1 = mesh.uv2, uv2 = mesh.uv3, uv3 = mesh.uv4;
        BoneWeight[] skins = mesh.boneWeights;
        var vertices = new Vertex[mesh.vertexCount];
        for (int n = 0; n < vertices.Length; n++)
            vertices[n] = new Vertex
            {
                position = positions[n], normal = normals[n], tangent = tangents[n], skin = skins[n],
                uv0 = AsStored(uv0, n), uv1 = AsStored(uv1, n), uv2 = AsStored(uv2, n), uv3 = AsStored(uv3, n),
            };
        geometry = new GraphicsBuffer(GraphicsBuffer.Target.Raw, vertices.Length * Stride / 4, 4);
        geometry.SetData(vertices);
        joints = new GraphicsBuffer(GraphicsBuffer.Target.Structured, skinned.bones.Length, 64);
        RenderPipelineManager.beginContextRendering += CorrectFrame;
        Camera.onPreRender += CorrectCamera; // Unity calls it in the built-in pipeline alone
    }

    void OnDisable()
    {
        RenderPipelineManager.beginContextRendering -= CorrectFrame;
        Camera.onPreRender -= CorrectCamera;
        geometry.Dispose();
        joints.Dispose();
    }

    // UnityGLTF turns V upside down, in sets that hold alpha and beta too.
    static Vector2 AsStored(Vector2[] set, int vertex)
    {
        return vertex < set.Length ? new Vector2(set[vertex].x, 1 - set[vertex].y) : new Vector2(0, 0);
    }

    void CorrectFrame(ScriptableRenderContext context, List<Camera> cameras)
    {
        Correct();
    }

    void CorrectCamera(Camera camera)
    {
        Correct();
    }

    // A second call in a frame gives the same normals: it begins with those at rest.
    void Correct()
    {
        using (GraphicsBuffer posed = skinned.GetVertexBuffer())
        {
            if (posed == null)
                return; // not skinned yet
            // Unity skins into the space of the root bone, without its scale.
            Transform root = skinned.rootBone != null ? skinned.rootBone : transform;
            Matrix4x4 space = Matrix4x4.TRS(root.position, root.rotation, Vector3.one).inverse;
            Transform[] bones = skinned.bones;
            Matrix4x4[] rest = skinned.sharedMesh.bindposes;
            var motions = new Matrix4x4[bones.Length];
            for (int n = 0; n < bones.Length; n++)
                motions[n] = space * bones[n].localToWorldMatrix * rest[n];
            joints.SetData(motions);
            int count = skinned.sharedMesh.vertexCount;
            pass.SetInt("skinbake_draw_vertices", count);
            pass.SetInt("skinbake_draw_targets", 0);
            pass.SetInt("skinbake_draw_joint_size", 4);
            pass.SetInt("skinbake_draw_weight_size", 4);
            pass.SetInt("skinbake_draw_posed_stride", posed.stride);
            pass.SetInt("skinbake_draw_posed_position", Absent); // Unity's own is right
            pass.SetInt("skinbake_draw_posed_normal", 12);
            pass.SetInt("skinbake_draw_posed_tangent", 24);
            pass.SetFloat("skinbake_draw_joint_scale", 1);
            pass.SetInts("skinbake_draw_position", 0, Stride);
            pass.SetInts("skinbake_draw_normal", 12, Stride);
            pass.SetInts("skinbake_draw_tangent", 24, Stride);
            for (int set = 0; set < 4; set++)
                pass.SetInts("skinbake_draw_texcoord_" + set, 40 + 8 * set, Stride);
            pass.SetInts("skinbake_draw_weights_0", 72, Stride);
            pass.SetInts("skinbake_draw_joints_0", 88, Stride);
            pass.SetBuffer(0, "skinbake_geometry", geometry);
            pass.SetBuffer(0, "skinbake_joints", joints);
            pass.SetBuffer(0, "skinbake_posed", posed);
            pass.Dispatch(0, (count + 63) / 64, 1, 1);
        }
    }
}
