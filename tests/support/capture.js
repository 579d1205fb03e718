// Record what vertex shaders hand on, while a page draws as it always does: each program whose vertex shader
// writes one of the names is linked with transform feedback, and each draw of it is run once more for it. The names
// are those of varyings, or gl_Position; namesFor may choose other ones for a vertex shader by its text.

const CAPTURE = { names: ['vNormal'], namesFor: () => CAPTURE.names, on: false, draws: [] };
window.CAPTURE = CAPTURE;

{
    const prototype = WebGL2RenderingContext.prototype;
    const { attachShader, drawArraysInstanced, drawElements, drawElementsInstanced, linkProgram, shaderSource } = prototype;
    const sources = new WeakMap();
    const shaders = new WeakMap();
    const recorded = new WeakMap();

    prototype.shaderSource = function (shader, source) {
        sources.set(shader, source);
        shaderSource.call(this, shader, source);
    };
    prototype.attachShader = function (program, shader) {
        shaders.set(program, [...(shaders.get(program) ?? []), shader]);
        attachShader.call(this, program, shader);
    };
    prototype.linkProgram = function (program) {
        const texts = shaders.get(program).map((shader) => sources.get(shader));
        const text = texts.find((one) => one.includes('gl_Position')) ?? '';
        const isWritten = (one) => one === 'gl_Position' || new RegExp(`(out|varying) +((?:highp|mediump) )?(vec3|mat3) ${one};`).test(text);
        const name = text && CAPTURE.namesFor(text).find(isWritten);
        if (name) {
            this.transformFeedbackVaryings(program, [name], this.INTERLEAVED_ATTRIBS);
            recorded.set(program, { name, text });
        }
        linkProgram.call(this, program);
    };
    prototype.drawElements = function (mode, count, type, offset) {
        record(this, count, type, offset, 1);
        drawElements.call(this, mode, count, type, offset);
    };
    prototype.drawElementsInstanced = function (mode, count, type, offset, instances) {
        record(this, count, type, offset, instances);
        drawElementsInstanced.call(this, mode, count, type, offset, instances);
    };

    function record(gl, count, type, offset, instances) {
        const program = gl.getParameter(gl.CURRENT_PROGRAM);
        const { name, text } = recorded.get(program) ?? {};
        if (!CAPTURE.on || !name) return;
        const Indices = { [gl.UNSIGNED_BYTE]: Uint8Array, [gl.UNSIGNED_SHORT]: Uint16Array }[type] ?? Uint32Array;
        const indices = new Indices(count);
        gl.getBufferSubData(gl.ELEMENT_ARRAY_BUFFER, offset, indices);
        const vertices = indices.reduce((largest, index) => Math.max(largest, index), 0) + 1;
        const size = name === 'gl_Position' ? 4 : new RegExp(`mat3 ${name};`).test(text) ? 9 : 3;
        const values = new Float32Array(size * vertices * instances);
        const buffer = gl.createBuffer();
        gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER, 0, buffer);
        gl.bufferData(gl.TRANSFORM_FEEDBACK_BUFFER, values.byteLength, gl.STREAM_READ);
        gl.enable(gl.RASTERIZER_DISCARD);
        gl.beginTransformFeedback(gl.POINTS);
        drawArraysInstanced.call(gl, gl.POINTS, 0, vertices, instances);
        gl.endTransformFeedback();
        gl.disable(gl.RASTERIZER_DISCARD);
        gl.getBufferSubData(gl.TRANSFORM_FEEDBACK_BUFFER, 0, values);
        gl.bindBufferBase(gl.TRANSFORM_FEEDBACK_BUFFER, 0, null);
        gl.deleteBuffer(buffer);
        CAPTURE.draws.push({ name, text, values, program, instances });
    }
}
