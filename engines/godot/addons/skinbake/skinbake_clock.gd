extends SubViewport
## A pixel that shows TIME, which scripts cannot read: by it vertex() tells the pose of this frame from that of the
## last one. Each viewport with baked meshes has one, which Godot draws before that viewport.

const CODE := """
shader_type canvas_item;
render_mode unshaded, blend_disabled;

void fragment() {
	uint bits = floatBitsToUint(TIME);
	COLOR = vec4(uvec4(bits, bits >> 8u, bits >> 16u, bits >> 24u) & uvec4(255u)) / 255.0;
}
"""


## By viewport.
static var _made: Dictionary = {}


## The texture of the clock of a viewport.
static func of(viewport: Viewport) -> Texture2D:
	var id := viewport.get_instance_id()
	if not is_instance_valid(_made.get(id)):
		_made[id] = new()
		viewport.add_child.call_deferred(_made[id], false, Node.INTERNAL_MODE_BACK)
	return _made[id].get_texture()


func _init() -> void:
	size = Vector2i(2, 2)
	disable_3d = true
	transparent_bg = true
	render_target_update_mode = SubViewport.UPDATE_ALWAYS
	# The code comes first: what takes a shader without code keeps it.
	var shader := Shader.new()
	shader.code = CODE
	var pixel := ColorRect.new()
	pixel.size = size
	pixel.material = ShaderMaterial.new()
	pixel.material.shader = shader
	add_child(pixel)
