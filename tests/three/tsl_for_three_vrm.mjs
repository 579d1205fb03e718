// three-vrm 3.5.5 imports a name from three/tsl that three.js 0.187 has under another name alone.

import { normalView } from 'three/tsl';

export * from 'three/tsl';
export const transformedNormalView = normalView;
