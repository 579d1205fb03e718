// Dual quaternions need rigid joints. In the space of the skeleton's parent, a joint's matrix may be a rigid motion
// after a linear map that all joints have in common, for example a scale or a mirror. The map is the stretch.

import { Mat4, Vec3 } from 'playcanvas';

const RIGID = 1e-3; // the largest entry of |Q^T Q - 1|, as in skinbake

export const NO_STRETCH = [1, 0, 0, 0, 1, 0, 0, 0, 1];

const matrix = new Mat4();
const toParent = new Mat4();
const unstretched = new Mat4();
const axes = [new Vec3(), new Vec3(), new Vec3()];
const normal = new Vec3();

// Return the stretch of the joints in use, nine numbers column by column, or why they are not rigid.
export function jointsOf({ skinInstance: { bones, skin } }, used) {
    const joints = (used ?? [...bones.keys()]).filter((joint) => joint < bones.length);
    if (!joints.length) return { problem: '', stretch: NO_STRETCH }; // the skeleton is not there yet
    const { parent } = topOf(bones, bones[joints[0]]);
    toParent.copy(parent ? parent.getWorldTransform() : Mat4.IDENTITY).invert();
    let stretch = null;
    for (const joint of joints) {
        matrix.mul2(toParent, bones[joint].getWorldTransform()).mul(skin.inverseBindPose[joint]);
        matrix.data.fill(0, 12, 15);
        if (!stretch) {
            const size = Math.cbrt(Math.abs(determinantOf(matrix)));
            stretch = [0, 1, 2, 4, 5, 6, 8, 9, 10].map((at) => matrix.data[at] / size);
            unstretched.copy(matrix).invert();
        }
        if (isRotation(matrix.mul(unstretched))) continue;
        const name = bones[joint].name;
        const problem = `its joint "${name}" is scaled otherwise than other joints: load it with the method lbs`;
        return { problem, stretch: NO_STRETCH };
    }
    return { problem: '', stretch };
}

function topOf(bones, bone) {
    let top = bone;
    for (let node = bone.parent; node; node = node.parent) if (bones.includes(node)) top = node;
    return top;
}

function determinantOf(one) {
    const [x, y, z] = [one.getX(axes[0]), one.getY(axes[1]), one.getZ(axes[2])];
    return normal.cross(x, y).dot(z);
}

function isRotation(one) {
    const isPositive = determinantOf(one) > 0;
    const isOne = (i, j) => Math.abs(axes[i].dot(axes[j]) - (i === j ? 1 : 0)) <= RIGID;
    return isPositive && axes.every((_, i) => axes.every((__, j) => isOne(i, j)));
}
