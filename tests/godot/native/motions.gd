extends CompositorEffect
## Reads the motion of each pixel back: Forward+'s own texture cannot be read by the CPU, so a shader copies it.

const CODE := """
#version 450
layout(local_size_x = 1, local_size_y = 1) in;
layout(set = 0, binding = 0) uniform sampler2D motions;
layout(set = 0, binding = 1, std430) buffer Copy { vec2 copied[]; };
void main() {
	ivec2 at = ivec2(gl_GlobalInvocationID.xy);
	copied[at.y * textureSize(motions, 0).x + at.x] = texelFetch(motions, at, 0).xy;
}
"""

var motions := PackedFloat32Array()
var _device := RenderingServer.get_rendering_device()
var _shader: RID
var _pipeline: RID


func _init() -> void:
	effect_callback_type = EFFECT_CALLBACK_TYPE_POST_TRANSPARENT
	needs_motion_vectors = true
	var source := RDShaderSource.new()
	source.source_compute = CODE
	_shader = _device.shader_create_from_spirv(_device.shader_compile_spirv_from_source(source))
	_pipeline = _device.compute_pipeline_create(_shader)


func free_rids() -> void:
	_device.free_rid(_pipeline)
	_device.free_rid(_shader)


func _render_callback(_type: int, data: RenderData) -> void:
	var buffers: RenderSceneBuffersRD = data.get_render_scene_buffers()
	var size := buffers.get_internal_size()
	var sampler := _device.sampler_create(RDSamplerState.new())
	var copy := _device.storage_buffer_create(8 * size.x * size.y)
	var uniforms: Array[RDUniform] = [RDUniform.new(), RDUniform.new()]
	uniforms[0].uniform_type = RenderingDevice.UNIFORM_TYPE_SAMPLER_WITH_TEXTURE
	uniforms[0].add_id(sampler)
	uniforms[0].add_id(buffers.get_velocity_texture())
	uniforms[1].uniform_type = RenderingDevice.UNIFORM_TYPE_STORAGE_BUFFER
	uniforms[1].binding = 1
	uniforms[1].add_id(copy)
	var set := _device.uniform_set_create(uniforms, _shader, 0)
	var list := _device.compute_list_begin()
	_device.compute_list_bind_compute_pipeline(list, _pipeline)
	_device.compute_list_bind_uniform_set(list, set, 0)
	_device.compute_list_dispatch(list, size.x, size.y, 1)
	_device.compute_list_end()
	motions = _device.buffer_get_data(copy).to_float32_array()
	for made: RID in [set, copy, sampler]:
		_device.free_rid(made)
