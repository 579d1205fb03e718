import type { Entity, Scene, SkinnedMeshRenderer } from '@galacean/engine';

/** The lighting that a mesh was last drawn with. `unlit`: its materials read no normals. */
export type DrawnLighting = 'accurate' | 'standard' | 'unlit' | 'not drawn';

/** An entity with all below it, a scene, or entities. */
export type MeshRoot = Entity | Scene | readonly Entity[];

/** What one skinned mesh was last drawn with. */
export interface MeshReport {
    readonly renderer: SkinnedMeshRenderer;
    readonly lighting: DrawnLighting;
    /** Why the lighting is not accurate. Empty if it is. */
    readonly reason: string;
}

/** Load alpha and beta with every glTF file from now on, for linear blending (`lbs`, the default) or dual quaternions. */
export function registerSkinbake(options?: { readonly method?: 'lbs' | 'dqs' }): void;

/** Load files as before. What is loaded stays as it is. */
export function unregisterSkinbake(): void;

/** Tell what each skinned mesh below a root was last drawn with, baked or not. A wrong root is a TypeError. */
export function report(root: MeshRoot): MeshReport[];

/** Switch the skinned meshes below a root to Galacean's own lighting, or back. */
export function lighting(root: MeshRoot, which: 'standard' | 'accurate'): void;
