// The programs of the page: what skinbake shader has written, called once for each vertex, and its shading.

export const LOCATIONS = {
    position: 0, normal: 1, tangent: 2, texcoord: 3, joints: 4, weights_0: 5, alpha_0: 6, beta_0: 7,
    further_texcoord: 8, weights_1: 9, alpha_1: 10, beta_1: 11, truth: 12, morphed_normal: 13, morphed_tangent: 14, color: 15,
    // In the place of these, where targets have numbers of the differential.
    morph: 13, morph_up: 14, morph_by_normal: 14,
};

// Where fragments find the texture coordinates of an image, by their number among those of its primitive.
export const TEXCOORDS = ['v_texcoord.xy', 'v_texcoord.zw', 'v_further_texcoord'];

// The name under which the page holds a text of skinbake shader.
export function textName({ stem, sets, frame, storage, morphs, mirrored }) {
    const how = stem === 'lbs_standard' ? 'float32' : storage;
    return [stem, 4 * sets, frame, how, morphs, stem === 'dqs_scaled' || (mirrored && stem === 'lbs_accurate') ? 'mirrored' : 'plain'].join('/');
}

// What vertices hand to fragments.
const VARYINGS = [
    'vec3 v_position', 'vec3 v_normal', 'vec4 v_cotangent', 'vec4 v_cobitangent', 'vec4 v_texcoord', 'vec2 v_further_texcoord',
    'vec4 v_color', 'vec2 v_error',
];
const varyings = (direction) => VARYINGS.map((one) => `${direction} ${one};`).join('\n');

// How each vertex shader of the model begins and ends.
const VERTEX_HEAD = `#version 300 es
precision highp float;
in vec3 position;
in vec3 normal;
in vec4 texcoord;
in vec2 further_texcoord;
in vec4 color;
uniform mat4 projected;
${varyings('out')}`;
const PASSED = `v_texcoord = texcoord;
    v_further_texcoord = further_texcoord;
    v_color = color;
    gl_Position = projected * vec4(v_position, 1.0);`;

// What each algorithm makes of the texels of a joint: its type, its name, and how.
const MOTIONS = {
    linear: ['mat4', 'M', 'return mat4(texel(joint, 0), texel(joint, 1), texel(joint, 2), texel(joint, 3));'],
    dqs_exact: ['mat2x4', 'Q', 'return mat2x4(texel(joint, 4), texel(joint, 5));'],
    dqs_scaled: ['skinbake_ScaledMotion', 'Q', `skinbake_ScaledMotion made;
    made.turn = texel(joint, 4);
    vec4 turn = made.turn == vec4(0.0) ? vec4(0.0, 0.0, 0.0, 1.0) : made.turn;
    for (int i = 0; i < 4; i++) made.moved[i] = skinbake_product(vec4(texel(joint, i).xyz, 0.0), turn);
    return made;`],
};

export function vertexText(text, choices) {
    const { stem, sets, frame, storage, morphs } = choices;
    const numbers = Array.from({ length: sets }, (_, set) => set);
    const reads = stem !== 'lbs_standard';
    const [type, name, made] = MOTIONS[stem] ?? MOTIONS.linear;
    // Each integer of the attribute holds two joints.
    const slots = Array.from({ length: 4 * sets }, (_, slot) => `motion(int(joints.${'xyzw'[slot >> 1]} >> ${16 * (slot & 1)}u & 65535u))`);
    const lists = (kind) => numbers.map((set) => `${kind}_${set}`);
    const inputs = lists('in vec4 weights').concat(reads ? lists('in vec4 stored_alpha').concat(lists('in vec4 stored_beta')) : []);
    const decoded = (kind, set) => {
        if (storage === 'float32') return `stored_${kind}_${set}${set ? '' : '.xyz'}`;
        if (set === 0) return `skinbake_decoded(stored_${kind}_0, storage_scale)`;
        return `skinbake_decoded_further(stored_${kind}_${set}, stored_${kind}_0, storage_scale)`;
    };
    const gradients = reads ? ['alpha', 'beta'].flatMap((kind) => numbers.map((set) => decoded(kind, set))) : [];
    const passed = ['scale * morphed_position', 'frame', name, ...lists('weights'), ...gradients].join(', ');
    // For normal maps: directions in xyz, and their lengths over that of the normal. As in engines, standard lighting
    // has no lengths. In the normal frame, both follow from TANGENT, if there is one.
    const given = frame === 'tangent' ? (morphs === 'tangent' ? 'frame' : 'rest') : 'rest, tangent';
    const along = (one) => `(dot(${one}, rest.tangent) * v.tangent + dot(${one}, rest.bitangent) * v.bitangent + dot(${one}, rest.normal) * v.normal)`;
    const columns = frame === 'tangent' ? ['v.tangent', 'v.bitangent'] :
        ['tangent.xyz', 'tangent.w * cross(rest.normal, tangent.xyz)'].map(along);
    const relief = reads ? ['map.cotangent', 'map.cobitangent'] : columns.map((one) => `vec4(normalize(${one}), 1.0)`);
    const [followed, ...morphed] = {
        none: [''],
        normal: ['frame = skinbake_morphed_frame(frame, morphed_normal);', 'vec3 morphed_normal'],
        tangent: ['frame = skinbake_morphed_tangent_frame(frame, morphed_normal, morphed_tangent);', 'vec3 morphed_normal', 'vec3 morphed_tangent'],
        frames: ['frame = skinbake_moved_frame(frame, morph, morph_up);', 'vec4 morph', 'vec2 morph_up'],
        'frames-normal': ['frame = skinbake_moved_frame_by_normal(frame, morphed_normal, morph_by_normal);', 'vec3 morphed_normal', 'vec4 morph_by_normal'],
    }[morphs];
    return `${VERTEX_HEAD}
precision highp int;
precision highp sampler2D;
${text}
in vec4 tangent;
in uvec4 joints;
in vec4 truth;
${morphed.map((one) => `in ${one};`).join('\n')}
${inputs.map((one) => `${one};`).join('\n')}
uniform sampler2D motions;
uniform float scale;
uniform float storage_scale;
uniform float is_true;

vec4 texel(int joint, int place) { return texelFetch(motions, ivec2(place, joint), 0); }

${type} motion(int joint)
{
    ${made}
}

void main()
{
    vec3 morphed_position = position;
    skinbake_Frame frame = skinbake_frame(normal${frame === 'tangent' ? ', tangent' : ''});
    skinbake_Frame rest = frame;
    ${followed}
    frame.tangent *= scale;
    frame.bitangent *= scale;
    rest.tangent *= scale;
    rest.bitangent *= scale;
    ${type} ${name}[${4 * sets}] = ${type}[${4 * sets}](${slots.join(', ')});
    skinbake_Vertex v = skinbake_${stem}(${passed});
    v_position = v.position;
    v_normal = mix(normalize(v.normal), truth.xyz, is_true * truth.w);
    ${reads ? `skinbake_NormalMap map = skinbake_normal_map(v, ${given});` : ''}
    v_cotangent = ${relief[0]};
    v_cobitangent = ${relief[1]};
    ${PASSED}
    v_error = vec2(degrees(atan(length(cross(v_normal, truth.xyz)), dot(v_normal, truth.xyz))) * truth.w, truth.w);
}
`;
}

// What no joint moves: the same on both sides.
export const RIGID_TEXT = `${VERTEX_HEAD}
uniform mat4 placed;

void main()
{
    mat3 linear = mat3(placed);
    v_position = (placed * vec4(position, 1.0)).xyz;
    v_normal = normalize(transpose(inverse(linear)) * normal);
    v_cotangent = v_cobitangent = vec4(0.0);
    v_error = vec2(0.0);
    ${PASSED}
}
`;

// The shading of one mode. has defines what a material has, with the texture coordinates of its images; software
// renderers run every branch.
export function fragmentText(mode, has) {
    const defined = [`MODE_${mode.toUpperCase()}`, ...has].map((one) => `#define ${one}\n`);
    return `#version 300 es\nprecision highp float;\n${defined.join('')}${FRAGMENT_TEXT}`;
}

const FRAGMENT_TEXT = `${varyings('in')}
uniform vec3 eye;
uniform mat3 studio; // right, up, and back from what is seen
uniform float legend;
uniform vec3 stops[5];
uniform vec3 unknown;
uniform vec4 base_factor;
uniform vec3 emissive_factor;
uniform float roughness;
uniform float normal_scale;
uniform vec2 alphas; // the least alpha that is drawn, and what it must be below
uniform bool is_turned; // seen from behind
uniform bool is_blended;
uniform sampler2D base_map;
uniform sampler2D normal_map;
uniform sampler2D emissive_map;
out vec4 result;

vec3 encoded(vec3 c) { return mix(12.92 * c, 1.055 * pow(c, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, c)); }

#ifdef NORMAL_TEXCOORD
vec3 mapped(vec3 n)
{
    vec3 m = texture(normal_map, NORMAL_TEXCOORD).xyz * 2.0 - 1.0;
    m.xy *= normal_scale;
#ifdef HAS_TANGENTS
    m.xy *= vec2(v_cotangent.w, v_cobitangent.w);
    return normalize(normalize(v_cotangent.xyz) * m.x + normalize(v_cobitangent.xyz) * m.y + n * m.z);
#else
    // The frame of the texture coordinates, from what changes between pixels.
    vec3 px = dFdx(v_position), py = dFdy(v_position);
    vec2 ux = dFdx(NORMAL_TEXCOORD), uy = dFdy(NORMAL_TEXCOORD);
    vec3 a = cross(py, n), c = cross(n, px);
    vec3 t = a * ux.x + c * uy.x;
    vec3 b = a * ux.y + c * uy.y;
    float size = inversesqrt(max(max(dot(t, t), dot(b, b)), 1e-30));
    return normalize(t * (m.x * size) + b * (m.y * size) + n * m.z);
#endif
}
#endif

// The key light grazes what faces the camera, the rim comes from behind, and a softbox is reflected.
const vec3 KEY = vec3(-0.80, 0.48, 0.36), RIM = vec3(0.72, 0.38, -0.58);

vec3 shaded(vec3 n, vec3 v, vec3 base)
{
    vec3 key = studio * KEY, h = normalize(key + v);
    float nl = max(dot(n, key), 0.0), nh = max(dot(n, h), 0.0), nv = max(dot(n, v), 1e-3);
    float a2 = roughness * roughness * roughness * roughness;
    float d = nh * nh * (a2 - 1.0) + 1.0;
    float k = (roughness + 1.0) * (roughness + 1.0) / 8.0;
    float shine = 0.04 + 0.96 * pow(1.0 - max(dot(v, h), 0.0), 5.0);
    float specular = shine * a2 / (d * d) / (4.0 * (nl * (1.0 - k) + k) * (nv * (1.0 - k) + k));
    vec3 sky = mix(vec3(0.10, 0.10, 0.105), vec3(0.27, 0.29, 0.32), 0.5 + 0.5 * dot(n, studio[1]));
    float rim = max(dot(n, studio * RIM), 0.0) * (0.35 + 0.65 * pow(1.0 - nv, 2.0));
    vec3 r = reflect(-v, n) * studio; // in the studio
    vec2 at = 1.0 - smoothstep(vec2(0.34, 0.5) - 0.3 * roughness, vec2(0.34, 0.5) + 0.3 * roughness, abs(r.xy / max(r.z, 0.05) - vec2(0.62, 0.3)));
    float box = at.x * at.y * step(0.0, r.z) * (0.05 + 0.95 * pow(1.0 - nv, 5.0));
    return base * (sky + 1.25 * nl * vec3(1.0, 0.98, 0.94) + 0.55 * rim * vec3(0.9, 0.95, 1.0)) + vec3(1.2 * nl * specular + 1.6 * box);
}

vec3 heat(float share)
{
    float at = clamp(share, 0.0, 1.0) * 4.0;
    int low = min(int(at), 3);
    return mix(stops[low], stops[low + 1], at - float(low));
}

void main()
{
    vec4 base = base_factor;
#ifdef HAS_COLORS
    base *= v_color;
#endif
#ifdef BASE_TEXCOORD
    vec4 texel = texture(base_map, BASE_TEXCOORD);
#ifdef IS_PLAIN
    base.a *= texel.a;
#else
    base *= texel;
#endif
#endif
    if (base.a < alphas.x || base.a >= alphas.y) discard;
    vec3 n = normalize(v_normal);
    vec3 v = normalize(eye - v_position);
    if (is_turned && !gl_FrontFacing) n = -n;
    vec3 color;
    float alpha = 1.0;
#ifdef MODE_SHADED
#ifdef IS_UNLIT
    color = encoded(base.rgb);
#else
#ifdef NORMAL_TEXCOORD
    n = mapped(n);
#endif
    color = shaded(n, v, base.rgb);
#ifdef EMISSIVE_TEXCOORD
    color += emissive_factor * texture(emissive_map, EMISSIVE_TEXCOORD).rgb;
#else
    color += emissive_factor;
#endif
    color = encoded(color / (1.0 + 0.18 * color));
#endif
    if (is_blended) alpha = base.a;
#endif
#ifdef MODE_REFLECTIONS
    vec3 r = reflect(-v, n);
    float at = asin(clamp(r.y * 0.94 + r.x * 0.34, -1.0, 1.0)) * 4.5;
    float width = max(fwidth(at), 1e-4);
    float wave = abs(fract(at) - 0.5) - 0.25;
    float line = clamp(0.5 + wave / width, 0.0, 1.0);
    float soft = smoothstep(0.5, 1.5, width);
    color = vec3(mix(mix(0.10, 0.93, line), 0.52, soft)) * (0.86 + 0.14 * max(dot(n, v), 0.0));
#endif
#ifdef MODE_ERROR
    color = mix(unknown, heat(v_error.x / legend), v_error.y > 0.99 ? 1.0 : 0.0);
    color *= 0.80 + 0.20 * max(dot(n, v), 0.0);
#endif
#ifdef MODE_NORMALS
    color = 0.5 + 0.5 * n;
#endif
    result = vec4(color * alpha, alpha);
}
`;

// The ground: rings around what stands on it, and its contact shadow.
export const GROUND_VERTEX_TEXT = `#version 300 es
precision highp float;
uniform mat4 projected;
uniform vec4 ground; // centre and radius
out vec2 v_place;
void main()
{
    v_place = vec2(gl_VertexID & 1, gl_VertexID >> 1) * 2.0 - 1.0;
    gl_Position = projected * vec4(ground.xyz + ground.w * vec3(v_place.x, 0.0, v_place.y), 1.0);
}
`;

export const GROUND_FRAGMENT_TEXT = `#version 300 es
precision highp float;
in vec2 v_place;
uniform vec3 ink;
out vec4 result;
void main()
{
    float far = length(v_place);
    float at = far * 6.0;
    float line = 1.0 - clamp(abs(fract(at - 0.5) - 0.5) / max(fwidth(at), 1e-4) - 0.2, 0.0, 1.0);
    float fade = smoothstep(1.0, 0.25, far);
    float shadow = 0.22 * smoothstep(0.42, 0.0, far);
    float alpha = max(0.10 * line * fade, shadow * fade);
    result = vec4(ink * alpha, alpha);
}
`;
