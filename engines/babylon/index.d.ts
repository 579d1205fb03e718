import type { AssetContainer, InstantiatedEntries } from '@babylonjs/core/assetContainer.js';
import type { AbstractMesh } from '@babylonjs/core/Meshes/abstractMesh.js';
import type { Mesh } from '@babylonjs/core/Meshes/mesh.js';
import type { Node } from '@babylonjs/core/node.js';
import type { Scene } from '@babylonjs/core/scene.js';

/** The lighting that a mesh was last drawn with. `unlit`: its materials read no normals. */
export type DrawnLighting = 'accurate' | 'standard' | 'unlit' | 'not drawn';

/** What holds meshes: a scene, a node with all below it, what a loader or a container returns, or the meshes themselves. */
export type MeshRoot =
    | Scene
    | Node
    | AssetContainer
    | InstantiatedEntries
    | { readonly meshes: AbstractMesh[] }
    | readonly AbstractMesh[];

/** What one baked mesh was last drawn with, read from the program that drew it. */
export interface MeshReport {
    readonly mesh: Mesh;
    readonly lighting: DrawnLighting;
    /** Why the lighting is not accurate. Empty if it is. */
    readonly reason: string;
}

/** Load alpha and beta with every glTF file from now on, for linear blending (`lbs`, the default) or dual quaternions. */
export function registerSkinbake(options?: { readonly method?: 'lbs' | 'dqs' }): void;

/** Load files as before. What is loaded stays as it is. */
export function unregisterSkinbake(): void;

/** Tell what each baked mesh was last drawn with. Instances are as their source. A wrong root is a TypeError. */
export function report(root: MeshRoot): MeshReport[];

/** Switch meshes to Babylon.js's own lighting, or back. Instances follow their source. */
export function lighting(root: MeshRoot, which: 'standard' | 'accurate'): void;
