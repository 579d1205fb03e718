const GLSL = {
    CUSTOM_VERTEX_DEFINITIONS: /* glsl */ `
#if SKINBAKE > 0
attribute vec4 skinbakeAlpha0;
attribute vec4 skinbakeBeta0;
#if NUM_BONE_INFLUENCERS > 4
attribute vec4 skinbakeAlpha1;
attribute vec4 skinbakeBeta1;
#endif
uniform float skinbakeScale;

//% for name, part in glsl.parts.items() if name not in [glsl.stem, "morphed_tangent"]
@{ part }

//% endfor
@{ glsl.parts.morphed_tangent }

#if NUM_BONE_INFLUENCERS > 4
@{ glsl.parts[glsl.stem] }
#else
@{ glsl_four.parts[glsl.stem] }
#endif

mat4 skinbake_joint(float index)
{
#ifdef BONETEXTURE
    return readMatrixFromRawSampler(boneSampler, index);
#else
    return mBones[int(index)];
#endif
}

// The world matrix of the mesh or of its instance, without the joints.
mat3 skinbake_world()
{
#ifdef INSTANCES
    mat3 instance = mat3(world0.xyz, world1.xyz, world2.xyz);
#ifdef THIN_INSTANCES
    return mat3(world) * instance;
#else
    return instance;
#endif
#else
    return mat3(world);
#endif
}

skinbake_Frame skinbake_rest()
{
    vec3 n0 = dot(normal, normal) > 0.0 ? normalize(normal) : vec3(0.0, 0.0, 1.0);
#if SKINBAKE > 2
    return skinbake_frame(n0, tangent);
#else
    return skinbake_frame(n0);
#endif
}

skinbake_Vertex skinbake_lit(vec3 p, skinbake_Frame frame)
{
    vec3 alpha_0 = skinbake_decoded(skinbakeAlpha0, skinbakeScale);
    vec3 beta_0 = skinbake_decoded(skinbakeBeta0, skinbakeScale);
    // Alpha and beta are for weights that sum to 1. Babylon.js does not divide them.
    vec4 weights_0 = matricesWeights;
    float total = dot(weights_0, vec4(1.0));
#if NUM_BONE_INFLUENCERS > 4
    vec4 weights_1 = matricesWeightsExtra;
    total += dot(weights_1, vec4(1.0));
    weights_1 = total > 0.0 ? weights_1 / total : vec4(0.0);
    mat4 M[8];
#else
    mat4 M[4];
#endif
    weights_0 = total > 0.0 ? weights_0 / total : vec4(1.0, 0.0, 0.0, 0.0);
//% for component in "xyzw"
    M[@{ loop.index0 }] = skinbake_joint(matricesIndices.@{ component });
//% endfor
#if NUM_BONE_INFLUENCERS > 4
//% for component in "xyzw"
    M[@{ loop.index0 + 4 }] = skinbake_joint(matricesIndicesExtra.@{ component });
//% endfor
    vec4 alpha_1 = skinbake_decoded_further(skinbakeAlpha1, skinbakeAlpha0, skinbakeScale);
    vec4 beta_1 = skinbake_decoded_further(skinbakeBeta1, skinbakeBeta0, skinbakeScale);
    return skinbake_@{ glsl.stem }(p, frame, M, weights_0, weights_1, alpha_0, alpha_1, beta_0, beta_1);
#else
    return skinbake_@{ glsl.stem }(p, frame, M, weights_0, alpha_0, beta_0);
#endif
}
#endif
`,
    // After Babylon.js's own lines, whose results are overwritten.
    CUSTOM_VERTEX_UPDATE_WORLDPOS: /* glsl */ `
#if SKINBAKE > 0
skinbake_Frame skinbakeRest = skinbake_rest();
#if SKINBAKE > 2 && defined(MORPHTARGETS) && defined(MORPHTARGETS_TANGENT)
skinbake_Frame skinbakeFrame = skinbake_morphed_tangent_frame(skinbakeRest, normalUpdated, tangentUpdated.xyz);
#else
skinbake_Frame skinbakeFrame = skinbakeRest;
// By morph targets, or by code of the page.
if (normalUpdated != normal) skinbakeFrame = skinbake_morphed_frame(skinbakeRest, normalUpdated);
#endif
skinbake_Vertex skinbakeLit = skinbake_lit(positionUpdated, skinbakeFrame);
mat3 skinbakeWorld = skinbake_world();
float skinbakeSide = determinant(skinbakeWorld) < 0.0 ? -1.0 : 1.0;
mat3 skinbakeCofactors = mat3(
    cross(skinbakeWorld[1], skinbakeWorld[2]),
    cross(skinbakeWorld[2], skinbakeWorld[0]),
    cross(skinbakeWorld[0], skinbakeWorld[1]));
vNormalW = skinbakeSide * normalize(skinbakeCofactors * skinbakeLit.normal);
#endif
`,
    CUSTOM_VERTEX_MAIN_END: /* glsl */ `
#if SKINBAKE > 0 && defined(TANGENT)
#if defined(BUMP) || defined(PARALLAX) || defined(CLEARCOAT_BUMP) || defined(ANISOTROPIC) || defined(GEOMETRY_NORMAL) || defined(GEOMETRY_COAT_NORMAL) || defined(FUZZ)
#if SKINBAKE > 2
vec3 skinbakeTangent = skinbakeLit.tangent;
#else
vec3 skinbakeTangent = dot(tangent.xyz, skinbakeRest.tangent) * skinbakeLit.tangent
    + dot(tangent.xyz, skinbakeRest.bitangent) * skinbakeLit.bitangent;
#endif
skinbakeTangent = normalize(skinbakeWorld * skinbakeTangent);
skinbakeSide *= sign(dot(cross(skinbakeLit.tangent, skinbakeLit.bitangent), skinbakeLit.normal));
skinbakeSide *= skinbakeFrame.handedness; // a joint that mirrors turns it round
vTBN = mat3(skinbakeTangent, skinbakeSide * tangent.w * cross(vNormalW, skinbakeTangent), vNormalW);
#endif
#endif
`,
};
