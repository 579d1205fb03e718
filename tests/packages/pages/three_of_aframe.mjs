// A-Frame has three.js inside it. With this file as 'three' in the import map, skinbake-three uses that one.

export const { BufferAttribute, DataTexture, FloatType, InstancedBufferAttribute } = globalThis.AFRAME.THREE;
export const { REVISION, ShaderChunk, ShaderLib, SkinnedMesh } = globalThis.AFRAME.THREE;
