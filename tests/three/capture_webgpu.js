// Record what vertex shaders hand on under WebGPU, while a page draws as it always does. Vertex shaders may not
// write to buffers there. So each draw is run once more with its own vertex shader, buffers and bind groups, its
// vertices as points: each is moved to a pixel of its own, where its values are stored as floats.

// How an engine writes the WGSL of vertex shaders: that of three.js, unless a page sets another one.
const THREE_DIALECT = {
    struct: 'struct VaryingsStruct {',
    returns: 'return varyings;',
    position: 'varyings.builtinClipSpace',
    captured: 'varyings.captured',
    indexed(code) {
        const index = /@builtin\( vertex_index \) (\w+)/.exec(code)?.[1];
        if (index) return [code, index];
        return [code.replace('fn main( ', 'fn main( @builtin( vertex_index ) capturedVertex : u32, '), 'capturedVertex'];
    },
};
const WEBGPU_CAPTURE = { name: 'v_normalViewGeometry', dialect: THREE_DIALECT, on: false, draws: [] };
window.WEBGPU_CAPTURE = WEBGPU_CAPTURE;

if (window.GPUDevice) {
    const WIDTH = 256;
    const codes = new WeakMap();
    const pipelines = new WeakMap();
    const passes = new WeakMap();
    const around = (prototype, name, act) => {
        const usual = prototype[name];
        prototype[name] = function (...parameters) {
            const result = usual.apply(this, parameters);
            act(this, result, ...parameters);
            return result;
        };
    };

    around(GPUDevice.prototype, 'createShaderModule', (device, module, { code }) => codes.set(module, code));
    for (const name of ['createRenderPipeline', 'createRenderPipelineAsync']) {
        around(GPUDevice.prototype, name, (device, result, { layout, vertex }) => {
            // three.js uses the descriptor again.
            const { buffers = [], module } = vertex;
            const used = buffers.map((buffer) => ({ ...buffer, attributes: buffer.attributes.map((one) => ({ ...one })) }));
            const kept = { device, layout, buffers: used, code: codes.get(module) };
            Promise.resolve(result).then((pipeline) => pipelines.set(pipeline, kept));
            if (!(result instanceof Promise)) pipelines.set(result, kept);
        });
    }
    const pass = GPURenderPassEncoder.prototype;
    const stateOf = (encoder) => {
        if (!passes.has(encoder)) passes.set(encoder, { groups: [], buffers: [] });
        return passes.get(encoder);
    };
    around(pass, 'setPipeline', (encoder, _, pipeline) => (stateOf(encoder).pipeline = pipelines.get(pipeline)));
    around(pass, 'setBindGroup', (encoder, _, index, group) => (stateOf(encoder).groups[index] = group));
    around(pass, 'setVertexBuffer', (encoder, _, slot, buffer, offset = 0) => {
        stateOf(encoder).buffers[slot] = { buffer, offset };
    });
    for (const name of ['draw', 'drawIndexed']) {
        around(pass, name, (encoder, _, count, instances = 1) => {
            const { pipeline, groups, buffers } = stateOf(encoder);
            if (!WEBGPU_CAPTURE.on || !pipeline?.code?.includes(WEBGPU_CAPTURE.dialect.struct)) return;
            WEBGPU_CAPTURE.draws.push({ pipeline, groups: [...groups], buffers: [...buffers], instances });
        });
    }

    // Return the values (4 floats each) of every vertex: the varying, or zeros, and the position in clip space.
    WEBGPU_CAPTURE.read = async ({ pipeline, groups, buffers }, instance = 0) => {
        const { device, layout, buffers: layouts, code } = pipeline;
        const counts = layouts.flatMap(({ arrayStride, stepMode = 'vertex' }, slot) => {
            const { buffer, offset } = buffers[slot];
            return stepMode === 'vertex' && arrayStride ? [Math.floor((buffer.size - offset) / arrayStride)] : [];
        });
        const vertices = Math.min(...counts);
        const height = Math.ceil(vertices / WIDTH);
        const module = device.createShaderModule({ code: moved(code, height) });
        const declared = `@location\\( ?(\\d+) ?\\) +(?:@interpolate\\([^)]*\\) +)?${WEBGPU_CAPTURE.name} : vec3`;
        const location = new RegExp(declared).exec(code)?.[1];
        const taken = location === undefined ? '' : `@location( ${location} ) handed : vec3<f32>,`;
        const given = location === undefined ? 'vec4<f32>()' : 'vec4<f32>( handed, 0.0 )';
        const fragment = device.createShaderModule({
            code: `
struct Values { @location( 0 ) handed : vec4<f32>, @location( 1 ) position : vec4<f32> }
@fragment fn main( ${taken} @location( 15 ) captured : vec4<f32> ) -> Values { return Values( ${given}, captured ); }`,
        });
        const target = { format: 'rgba32float' };
        const again = device.createRenderPipeline({
            layout,
            vertex: { module, buffers: layouts },
            fragment: { module: fragment, targets: [target, target] },
            primitive: { topology: 'point-list' },
        });
        const usage = GPUTextureUsage.RENDER_ATTACHMENT | GPUTextureUsage.COPY_SRC;
        const textures = [0, 1].map(() => device.createTexture({ size: [WIDTH, height], format: 'rgba32float', usage }));
        const commands = device.createCommandEncoder();
        const encoder = commands.beginRenderPass({
            colorAttachments: textures.map((one) => ({ view: one.createView(), loadOp: 'clear', storeOp: 'store' })),
        });
        encoder.setPipeline(again);
        groups.forEach((group, index) => group && encoder.setBindGroup(index, group));
        layouts.forEach((_, slot) => encoder.setVertexBuffer(slot, buffers[slot].buffer, buffers[slot].offset));
        encoder.draw(vertices, 1, 0, instance);
        encoder.end();
        const read = textures.map((texture) => {
            const usage = GPUBufferUsage.COPY_DST | GPUBufferUsage.MAP_READ;
            const buffer = device.createBuffer({ size: 16 * WIDTH * height, usage });
            commands.copyTextureToBuffer({ texture }, { buffer, bytesPerRow: 16 * WIDTH }, [WIDTH, height]);
            return buffer;
        });
        device.queue.submit([commands.finish()]);
        const values = await Promise.all(
            read.map(async (buffer) => {
                await buffer.mapAsync(GPUMapMode.READ);
                return new Float32Array(buffer.getMappedRange().slice(0, 16 * vertices));
            }),
        );
        [...textures, ...read].forEach((one) => one.destroy());
        return { name: location === undefined ? '' : WEBGPU_CAPTURE.name, varying: values[0], position: values[1] };
    };

    function moved(code, height) {
        const { struct, returns, position, captured, indexed } = WEBGPU_CAPTURE.dialect;
        const [text, index] = indexed(code);
        const at = (coordinate, size) => `2.0 * ( f32( ${coordinate} ) + 0.5 ) / ${size}.0 - 1.0`;
        return text
            .replace(struct, `${struct} @location( 15 ) captured : vec4<f32>,`)
            .replace(
                returns,
                `${captured} = ${position};
                ${position} = vec4<f32>( ${at(`${index} % ${WIDTH}u`, WIDTH)},
                    - ( ${at(`${index} / ${WIDTH}u`, height)} ), 0.0, 1.0 );
                ${returns}`,
            );
    }
}
