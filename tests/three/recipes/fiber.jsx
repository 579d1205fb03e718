// The recipe for react-three-fiber: what gltfjsx writes, with a material inline that is replaced.

import { createRoot, extend, useLoader } from '@react-three/fiber';
import React from 'react';
import * as THREE from 'three';
import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
import { applySkinbake, SkinbakePlugin } from 'skinbake-three';

extend(THREE);

// What gltfjsx writes: new meshes around geometries and skeletons, with materials inline.
function Model({ gltf, mesh, colour }) {
    return (
        <group>
            <primitive object={gltf.scene} />
            <skinnedMesh geometry={mesh.geometry} skeleton={mesh.skeleton} frustumCulled={false}>
                <meshStandardMaterial key={colour} color={colour} />
            </skinnedMesh>
        </group>
    );
}

window.show = async ({ url, pose }) => {
    const loader = new GLTFLoader();
    loader.register((parser) => new SkinbakePlugin(parser));
    const gltf = await loader.loadAsync(url);
    const mixer = new THREE.AnimationMixer(gltf.scene);
    mixer.clipAction(gltf.animations[pose.clip]).play();
    mixer.setTime(pose.time);
    let mesh;
    gltf.scene.traverse((object) => {
        if (object.isSkinnedMesh) mesh = object;
    });
    const world = mesh.matrixWorld.toArray();
    mesh.removeFromParent();
    const canvas = document.createElement('canvas');
    document.body.append(canvas);
    const root = createRoot(canvas);
    await root.configure({ frameloop: 'never', size: { width: 64, height: 64, top: 0, left: 0 }, camera: { position: [0, 0, 0] } });
    const found = [];
    for (const colour of ['orange', 'teal']) {
        const store = root.render(<Model gltf={gltf} mesh={mesh} colour={colour} />);
        await new Promise((resolve) => setTimeout(resolve, 500));
        const { gl, scene, camera } = store.getState();
        camera.position.set(0, 0, 0);
        camera.quaternion.identity();
        CAPTURE.draws = [];
        CAPTURE.on = true;
        for (let frame = 0; frame < 2; frame++) gl.render(scene, camera);
        CAPTURE.on = false;
        const values = CAPTURE.draws.at(-1).values;
        const reports = [];
        scene.traverse((o) => { if (o.isSkinnedMesh) reports.push(...applySkinbake(o).map((one) => [one.lighting, one.mesh.material.color.getHexString(), o.matrixWorld.toArray()])); });
        found.push({ values: btoa(Array.from(new Uint8Array(values.buffer), (c) => String.fromCharCode(c)).join('')), reports });
    }
    return { found, world };
};

const accurately = (loader) => loader.register((parser) => new SkinbakePlugin(parser));

// What gltfjsx and useGLTF do: the file is loaded before the component asks for it, with the function or without it.
// Return the lighting of each mesh.
window.preloaded = async ({ url, isExtended }) => {
    useLoader.preload(GLTFLoader, url, isExtended ? accurately : undefined);
    function Hero() {
        return <primitive object={useLoader(GLTFLoader, url, accurately).scene} />;
    }
    const root = createRoot(document.body.appendChild(document.createElement('canvas')));
    await root.configure({ frameloop: 'never', size: { width: 64, height: 64, top: 0, left: 0 } });
    const { getState } = root.render(<React.Suspense fallback={null}><Hero /></React.Suspense>);
    const meshes = [];
    while (!meshes.length) {
        await new Promise((resolve) => setTimeout(resolve, 50));
        getState().scene.traverse((object) => object.isSkinnedMesh && meshes.push(object));
    }
    for (const mesh of meshes) mesh.frustumCulled = false;
    const { gl, scene, camera } = getState();
    for (let frame = 0; frame < 2; frame++) gl.render(scene, camera);
    const programs = meshes.map(({ material }) => gl.properties.get(material).currentProgram.getAttributes());
    return programs.map((attributes) => ('morphSkinbakeAlpha' in attributes ? 'accurate' : 'standard'));
};
