// A-Frame has three.js inside it. With this file as 'three' in the import map, skinbake-three uses that one.

export const { BufferAttribute, InstancedBufferAttribute, REVISION, ShaderChunk, SkinnedMesh } = globalThis.AFRAME.THREE;
