// Models in the poses that the tests ask for.

import * as THREE from 'three';

export function skinnedMeshes(root) {
    const found = [];
    root.traverse((object) => {
        if (object.isSkinnedMesh) found.push(object);
    });
    return found;
}

// Put a loaded model into a pose, and return its skinned meshes. The pose is { clip, time }, or { turned }: a
// quaternion (w, x, y, z) for each joint, after its own rotation. morphs are the influences of morph targets.
export function posed({ scene, animations }, pose, morphs) {
    if (pose.clip !== undefined) {
        const mixer = new THREE.AnimationMixer(scene);
        mixer.clipAction(animations[pose.clip]).play();
        mixer.setTime(pose.time);
    }
    const meshes = skinnedMeshes(scene);
    for (const [joint, [w, x, y, z]] of (pose.turned ?? []).entries()) {
        meshes[0].skeleton.bones[joint].quaternion.multiply(new THREE.Quaternion(x, y, z, w));
    }
    for (const mesh of meshes) {
        if (morphs) mesh.morphTargetInfluences = morphs;
    }
    return meshes;
}

// Put a model below a parent with the matrix root. With the matrix other, its mesh goes below another parent with that
// matrix; detached is a bind mode. Return the mesh.
export function parented(scene, model, { root, other, detached }) {
    const below = (matrix, child) => {
        const parent = new THREE.Group();
        parent.matrixAutoUpdate = false;
        parent.matrix.fromArray(matrix);
        scene.add(parent.add(child));
    };
    below(root, model);
    const [mesh] = skinnedMeshes(model);
    if (other) below(other, mesh);
    if (detached) mesh.bindMode = THREE.DetachedBindMode;
    return mesh;
}

// Give the last joint but one a scale of its own, or take it away.
export function stretch(root, isStretched) {
    const { bones } = skinnedMeshes(root)[0].skeleton;
    bones.at(-2).scale.set(1, isStretched ? 1.3 : 1, 1);
}

let moment = performance.now();
performance.now = () => moment;

// Let so many milliseconds pass for all that asks performance.now(). Else none pass, however slow the machine is.
export function pass(milliseconds) {
    moment += milliseconds;
}
