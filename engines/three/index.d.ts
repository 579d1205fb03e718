import type { Object3D, SkinnedMesh } from 'three';
import type { GLTF, GLTFLoaderPlugin, GLTFParser } from 'three/addons/loaders/GLTFLoader.js';

/**
 * The lighting that a mesh was last drawn with. `unlit`: its materials read no normals, as MeshDepthMaterial. Only
 * WebGLRenderer reports it; WebGPURenderer reports `accurate` for such a mesh.
 */
export type DrawnLighting = 'accurate' | 'standard' | 'unlit' | 'not drawn';

export interface SkinbakeOptions {
    /** Linear blending, which is three.js's own, or dual quaternions. */
    method?: 'lbs' | 'dqs';
    /** The largest correction of a tangent, in parts of its length, from 1e-6 to 1e6. By default, none. */
    cap?: number;
}

/** What one skinned mesh is drawn with. It is read from the program that drew it, and stays up to date. */
export interface MeshReport {
    readonly mesh: SkinnedMesh;
    readonly lighting: DrawnLighting;
    /** Why the lighting is not accurate. Empty if it is. */
    readonly reason: string;
    /**
     * How normal maps, that of the clear coat, and anisotropy follow the surface. `accurate`: as a relief over it.
     * `derivatives`: without TANGENT, by three.js's frame of the triangle at the pixel. `standard`: by three.js's frame
     * of normal and tangent.
     */
    readonly normalMap: 'accurate' | 'derivatives' | 'standard' | 'none';
}

/** Light the baked skinned meshes below an object accurately. Doing it again repairs what was changed since. */
export function applySkinbake(root: Object3D, options?: SkinbakeOptions): MeshReport[];

/** Tell the lighting of the skinned meshes below an object, baked or not. applySkinbake returns the same. */
export function report(root: Object3D): MeshReport[];

/** Switch the skinned meshes below an object to three.js's own lighting, or back. */
export function lighting(root: Object3D, which: 'standard' | 'accurate'): void;

/** Undo applySkinbake for the skinned meshes below an object. Clones in a scene, which share their geometries, stay. */
export function dispose(root: Object3D): void;

/** A plugin of GLTFLoader. The loaded object has the report in `userData.skinbake`. */
export class SkinbakePlugin implements GLTFLoaderPlugin {
    constructor(parser: GLTFParser, options?: SkinbakeOptions);
    readonly name: string;
    readonly parser: GLTFParser;
    readonly method: 'lbs' | 'dqs';
    readonly cap?: number;
    afterRoot(gltf: GLTF): Promise<void> | null;
}
