import type { AppBase, Entity, MeshInstance } from 'playcanvas';

/** The lighting that a mesh was last drawn with. `unlit`: its materials read no normals. */
export type DrawnLighting = 'accurate' | 'standard' | 'unlit' | 'not drawn';

export interface SkinbakeOptions {
    /** Linear blending, which is PlayCanvas's own, or dual quaternions. */
    method?: 'lbs' | 'dqs';
}

/** What one skinned mesh is drawn with. It is read from the programs that drew it, and stays up to date. */
export interface MeshReport {
    readonly meshInstance: MeshInstance;
    readonly lighting: DrawnLighting;
    /** Why the lighting is not accurate. Empty if it is. */
    readonly reason: string;
}

/**
 * Make the options of a container asset: the fifth parameter of `new Asset()`. Its baked skinned meshes are lit
 * accurately wherever the application draws them. `others` are further options of the asset.
 */
export function skinbakeOptions(app: AppBase, options?: SkinbakeOptions, others?: object): object;

/** Tell the lighting of the skinned meshes below an entity. Another root is a TypeError. */
export function report(root: Entity): MeshReport[];

/** Switch the skinned meshes below an entity to PlayCanvas's own lighting, or back. */
export function lighting(root: Entity, which: 'standard' | 'accurate'): void;

/** Undo everything for an application. */
export function dispose(app: AppBase): void;
