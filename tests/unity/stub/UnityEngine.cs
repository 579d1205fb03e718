// Stand-ins for the types of Unity that engines/unity uses, by their names and signatures in Unity's documentation.
// Main makes one mesh of a file, draws one frame, and writes what the compute pass was given.

using System;
using System.Collections.Generic;
using System.IO;
using System.Reflection;
using System.Runtime.InteropServices;
using UnityEngine.Rendering;

namespace UnityEngine
{
    public struct Vector2 { public float x, y; public Vector2(float x, float y) { this.x = x; this.y = y; } }

    public struct Vector3
    {
        public float x, y, z;
        public Vector3(float x, float y, float z) { this.x = x; this.y = y; this.z = z; }
        public static Vector3 one { get { return new Vector3(1, 1, 1); } }
    }

    public struct Vector4 { public float x, y, z, w; }

    public struct Quaternion { public float x, y, z, w; }

    // Sixteen floats, column by column.
    [StructLayout(LayoutKind.Sequential)]
    public struct Matrix4x4
    {
        [MarshalAs(UnmanagedType.ByValArray, SizeConst = 16)]
        float[] values;

        public Matrix4x4(float[] values) { this.values = values; }

        public static Matrix4x4 operator *(Matrix4x4 a, Matrix4x4 b)
        {
            var found = new float[16];
            for (int column = 0; column < 4; column++)
                for (int row = 0; row < 4; row++)
                    for (int n = 0; n < 4; n++)
                        found[4 * column + row] += a.values[4 * n + row] * b.values[4 * column + n];
            return new Matrix4x4(found);
        }

        public static Matrix4x4 TRS(Vector3 p, Quaternion q, Vector3 s)
        {
            return new Matrix4x4(new float[] {
                s.x * (1 - 2 * (q.y * q.y + q.z * q.z)), s.x * 2 * (q.x * q.y + q.z * q.w), s.x * 2 * (q.x * q.z - q.y * q.w), 0,
                s.y * 2 * (q.x * q.y - q.z * q.w), s.y * (1 - 2 * (q.x * q.x + q.z * q.z)), s.y * 2 * (q.y * q.z + q.x * q.w), 0,
                s.z * 2 * (q.x * q.z + q.y * q.w), s.z * 2 * (q.y * q.z - q.x * q.w), s.z * (1 - 2 * (q.x * q.x + q.y * q.y)), 0,
                p.x, p.y, p.z, 1 });
        }

        // Of a motion without scale.
        public Matrix4x4 inverse
        {
            get
            {
                var found = new float[16];
                for (int a = 0; a < 3; a++)
                    for (int b = 0; b < 3; b++)
                    {
                        found[4 * a + b] = values[4 * b + a];
                        found[12 + b] -= values[4 * b + a] * values[12 + a];
                    }
                found[15] = 1;
                return new Matrix4x4(found);
            }
        }
    }

    [StructLayout(LayoutKind.Sequential)]
    public struct BoneWeight
    {
        public float weight0, weight1, weight2, weight3;
        public int boneIndex0, boneIndex1, boneIndex2, boneIndex3;
    }

    public class Object { }

    public class Component : Object
    {
        public Transform transform;
        internal Component beside;
        public T GetComponent<T>() where T : Component { return (T)beside; }
    }

    public class MonoBehaviour : Component { }

    public class Transform : Component
    {
        public Vector3 position;
        public Quaternion rotation;
        public Matrix4x4 localToWorldMatrix;
    }

    [AttributeUsage(AttributeTargets.Class)]
    public class RequireComponent : Attribute { public RequireComponent(Type type) { } }

    public class Mesh : Object
    {
        public Vector3[] vertices, normals;
        public Vector4[] tangents;
        public Vector2[] uv, uv2, uv3, uv4;
        public BoneWeight[] boneWeights;
        public Matrix4x4[] bindposes;
        public int vertexCount { get { return vertices.Length; } }
    }

    public class SkinnedMeshRenderer : Component
    {
        public Mesh sharedMesh;
        public Transform rootBone;
        public Transform[] bones;
        public GraphicsBuffer.Target vertexBufferTarget = GraphicsBuffer.Target.Vertex;
        internal bool isSkinned;

        public GraphicsBuffer GetVertexBuffer()
        {
            if ((vertexBufferTarget & GraphicsBuffer.Target.Raw) == 0)
                throw new InvalidOperationException("the vertex buffer is not raw");
            return isSkinned ? new GraphicsBuffer(vertexBufferTarget, sharedMesh.vertexCount, 40) : null;
        }
    }

    public sealed class GraphicsBuffer : IDisposable
    {
        [Flags]
        public enum Target { Vertex = 1, Structured = 16, Raw = 32 }

        public static int alive;
        public readonly int count, stride;
        internal byte[] data;

        public GraphicsBuffer(Target target, int count, int stride) { this.count = count; this.stride = stride; alive++; }

        public void SetData(Array values)
        {
            int size = Marshal.SizeOf(values.GetType().GetElementType());
            data = new byte[values.Length * size];
            if (data.Length > count * stride)
                throw new ArgumentException(data.Length + " bytes for a buffer of " + count * stride);
            IntPtr at = Marshal.AllocHGlobal(size);
            for (int n = 0; n < values.Length; n++)
            {
                Marshal.StructureToPtr(values.GetValue(n), at, false);
                Marshal.Copy(at, data, n * size, size);
            }
            Marshal.FreeHGlobal(at);
        }

        public void Dispose() { alive--; }
    }

    public class ComputeShader : Object
    {
        internal readonly List<string> numbers = new List<string>();
        internal readonly Dictionary<string, byte[]> buffers = new Dictionary<string, byte[]>();
        internal string groups;

        public void SetInt(string name, int value) { numbers.Add(name + " " + value); }
        public void SetInts(string name, params int[] values) { numbers.Add(name + " " + string.Join(" ", values)); }
        public void SetFloat(string name, float value) { numbers.Add(name + " " + value); }
        public void SetBuffer(int kernel, string name, GraphicsBuffer buffer) { buffers[name] = buffer.data; }
        public void Dispatch(int kernel, int x, int y, int z) { groups = x + " " + y + " " + z; }
    }

    public class Camera
    {
        public delegate void CameraCallback(Camera camera);
        public static CameraCallback onPreRender;
    }

    static class Program
    {
        static BinaryReader given;

        static float[] Floats(int count)
        {
            var found = new float[count];
            for (int n = 0; n < count; n++)
                found[n] = given.ReadSingle();
            return found;
        }

        static T[] Structs<T>(int count)
        {
            var found = new T[count];
            int size = Marshal.SizeOf(typeof(T));
            IntPtr at = Marshal.AllocHGlobal(size);
            for (int n = 0; n < count; n++)
            {
                Marshal.Copy(given.ReadBytes(size), 0, at, size);
                found[n] = (T)Marshal.PtrToStructure(at, typeof(T));
            }
            Marshal.FreeHGlobal(at);
            return found;
        }

        static void Main(string[] arguments)
        {
            given = new BinaryReader(File.OpenRead(arguments[0]));
            int count = given.ReadInt32(), bones = given.ReadInt32();
            var mesh = new Mesh
            {
                vertices = Structs<Vector3>(count), normals = Structs<Vector3>(count), tangents = Structs<Vector4>(count),
                uv = Structs<Vector2>(count), uv2 = Structs<Vector2>(count), uv3 = Structs<Vector2>(count),
                uv4 = Structs<Vector2>(count), boneWeights = Structs<BoneWeight>(count), bindposes = Structs<Matrix4x4>(bones),
            };
            var renderer = new SkinnedMeshRenderer { sharedMesh = mesh, bones = new Transform[bones] };
            for (int n = 0; n < bones; n++)
                renderer.bones[n] = new Transform { localToWorldMatrix = new Matrix4x4(Floats(16)) };
            renderer.rootBone = new Transform { position = Structs<Vector3>(1)[0], rotation = Structs<Quaternion>(1)[0] };
            var component = new Skinbake { pass = new ComputeShader(), beside = renderer };
            Call(component, "OnEnable");
            Draw(arguments[2]);
            if (component.pass.groups != null)
                throw new Exception("it corrects before Unity has skinned");
            renderer.isSkinned = true;
            Draw(arguments[2]);
            Call(component, "OnDisable");
            if (Camera.onPreRender != null)
                throw new Exception("it listens after it was disabled");
            component.pass.numbers.Add("groups " + component.pass.groups);
            component.pass.numbers.Add("alive " + GraphicsBuffer.alive);
            File.WriteAllLines(Path.Combine(arguments[1], "numbers"), component.pass.numbers);
            foreach (var buffer in component.pass.buffers)
                File.WriteAllBytes(Path.Combine(arguments[1], buffer.Key), buffer.Value ?? new byte[0]);
        }

        static void Draw(string pipeline)
        {
            if (pipeline == "built-in")
                Camera.onPreRender(new Camera());
            else
                RenderPipelineManager.Draw();
        }

        static void Call(object component, string name)
        {
            component.GetType().GetMethod(name, BindingFlags.Instance | BindingFlags.NonPublic).Invoke(component, null);
        }
    }
}

namespace UnityEngine.Rendering
{
    public struct ScriptableRenderContext { }

    public static class RenderPipelineManager
    {
        public static event Action<ScriptableRenderContext, List<Camera>> beginContextRendering;

        internal static void Draw()
        {
            if (beginContextRendering != null)
                beginContextRendering(new ScriptableRenderContext(), new List<Camera>());
        }
    }
}
