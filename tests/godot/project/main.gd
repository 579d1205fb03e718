extends Node3D
## Shows baked files as the page asks: window.show(words) loads one, poses it, and answers in window.answer.
## window.change(name) changes the running scene as a game may. window.look() answers in window.seen.

const Importer := preload("res://addons/skinbake/skinbake_import.gd")
const Materials := preload("res://addons/skinbake/skinbake_material.gd")

## Each value of what decides the text of a copy's shader.
const CHOICES := {
	"blend_mode": [1, 2, 3, 4],
	"depth_draw_mode": [1, 2],
	"cull_mode": [1, 2],
	"diffuse_mode": [1, 2, 3],
	"specular_mode": [1, 2],
	"shading_mode": [0, 2],
	"texture_filter": [0, 1, 2, 4, 5],
	"transparency": [1, 2, 3, 4],
	"emission_enabled": [true],
	"emission_operator": [1],
	"emission_on_uv2": [true],
	"ao_enabled": [true],
	"ao_on_uv2": [true],
	"rim_enabled": [true],
	"clearcoat_enabled": [true],
	"grow": [true],
	"vertex_color_use_as_albedo": [true],
	"vertex_color_is_srgb": [true],
	"albedo_texture_force_srgb": [true],
	"texture_repeat": [false],
	"no_depth_test": [true],
	"shadow_to_opacity": [true],
	"disable_receive_shadows": [true],
	"disable_ambient_light": [true],
	"disable_fog": [true],
	"alpha_antialiasing_mode": [1, 2],
	"depth_test": [1],
	"detail_uv_layer": [1],
	"disable_specular_occlusion": [true],
	"use_z_clip_scale": [true],
	"use_fov_override": [true],
}
## Where a material has textures.
const TEXTURES := [
	BaseMaterial3D.TEXTURE_ALBEDO,
	BaseMaterial3D.TEXTURE_METALLIC,
	BaseMaterial3D.TEXTURE_ROUGHNESS,
	BaseMaterial3D.TEXTURE_EMISSION,
	BaseMaterial3D.TEXTURE_NORMAL,
	BaseMaterial3D.TEXTURE_RIM,
	BaseMaterial3D.TEXTURE_CLEARCOAT,
	BaseMaterial3D.TEXTURE_AMBIENT_OCCLUSION,
	BaseMaterial3D.TEXTURE_ORM,
]

var _callbacks: Array[JavaScriptObject] = []
var _scene: Node3D
var _joints := PackedStringArray()
var _camera := Camera3D.new()
var _light := DirectionalLight3D.new()
var _furniture: Array[Node] = []
## The last material that a change has set.
var _given: Material
var _before: Material
## A mesh that has left the scene.
var _left: MeshInstance3D
var _window := JavaScriptBridge.get_interface("window")


func _ready() -> void:
	GLTFDocument.register_gltf_document_extension(Importer.new())
	add_child(_camera)
	_camera.make_current()
	_light.light_energy = 0.5
	_light.rotation = Vector3(-0.4, 0.6, 0.0)
	_light.directional_shadow_mode = DirectionalLight3D.SHADOW_ORTHOGONAL
	add_child(_light)
	for name: String in ["show", "change", "look"]:
		_callbacks.append(JavaScriptBridge.create_callback(Callable(self, "_on_" + name)))
		_window[name] = _callbacks[-1]
	_window.isStarted = true


func _on_show(arguments: Array) -> void:
	_window.answer = JSON.stringify(_show(JSON.parse_string(arguments[0])))


func _on_change(arguments: Array) -> void:
	call("_" + arguments[0], _meshes()[0])


func _on_look(_arguments: Array) -> void:
	var box: AABB = _meshes()[0].custom_aabb
	var seen := _told()
	seen.bounds = [_numbers(box.position), _numbers(box.end)]
	seen.keeps = _meshes()[0].get_surface_override_material(0) == _given
	seen.isLeftSkinned = is_instance_valid(_left) and _left.skin != null
	seen.passes = _colours(_meshes()[0].get_active_material(0))
	_window.seen = JSON.stringify(seen)


func _told() -> Dictionary:
	return {
		"report": _scene.get_node("Skinbake").report if _scene.has_node("Skinbake") else [],
		"skinned": _meshes().map(func(mesh: MeshInstance3D) -> bool: return mesh.skin != null),
		"tangents": _meshes().map(_has_tangents),
	}


static func _has_tangents(mesh: MeshInstance3D) -> bool:
	return mesh.mesh.get_surface_count() > 0 and mesh.mesh.surface_get_format(0) & Mesh.ARRAY_FORMAT_TANGENT


## The colour of a material and of its next passes.
static func _colours(material: Material) -> Array[String]:
	var found: Array[String] = []
	while material != null:
		if material is ShaderMaterial:
			found.append(str(material.get_shader_parameter(&"albedo")))
		else:
			found.append(str(material.albedo_color))
		material = material.next_pass
	return found


func _show(asked: Dictionary) -> Dictionary:
	if _scene != null:
		remove_child(_scene)
		_scene.queue_free()
	var document := GLTFDocument.new()
	var state := GLTFState.new()
	var error := document.append_from_buffer(
		FileAccess.get_file_as_bytes(asked.path), "/", state, asked.get("flags", 0)
	)
	if error != OK:
		_scene = null
		return {"error": error_string(error)}
	_scene = document.generate_scene(state)
	_joints = _names_of_joints(state)
	var meshes := _meshes()
	if asked.has("material"):
		for mesh: MeshInstance3D in meshes:
			mesh.set_surface_override_material(0, call("_" + asked.material))
	if asked.has("properties"):
		meshes[0].set_surface_override_material(0, _varied(asked.properties))
	if asked.has("change"):
		call("_" + asked.change, meshes[0])
	if asked.has("method"):
		_scene.get_node("Skinbake").method = asked.method
	add_child(_scene)
	if asked.get("isCopied", false):
		var copy: Node3D = _scene.duplicate()
		remove_child(_scene)
		_scene.queue_free()
		_scene = copy
		add_child(_scene)
		meshes = _meshes()
	if asked.get("isStandard", false):
		_scene.get_node("Skinbake").dispose()
		if asked.get("isRigid", false):
			meshes[0].skin = null
			meshes[0].skeleton = NodePath()
	_pose(asked)
	if asked.get("isFurnished", false):
		_scene.rotation.y = 0.8
	if asked.get("isTurned", false):
		_scene.rotation.y = PI
	# The camera is not turned, so that normals before it are normals in the world.
	var bounds: AABB = meshes[0].global_transform * meshes[0].get_aabb()
	_camera.position = bounds.get_center() + Vector3(0.0, 0.0, 0.8 * bounds.size.length())
	_light.visible = asked.get("isLit", false)
	_light.shadow_enabled = asked.get("isShadowed", false)
	_furnish(asked.get("isFurnished", false))
	if asked.get("isScreened", false):
		# What is behind the mesh receives its shadow.
		_add_wall(bounds.get_center() - Vector3(0.0, 0.0, bounds.size.length()), Vector2(20.0, 20.0), Color.WHITE, 0, false)
	var told := _told()
	told.world = _matrix(meshes[0].global_transform)
	return told


## What the modes of materials act on: walls before and behind the mesh, ambient light and fog.
func _furnish(is_furnished: bool) -> void:
	_light.light_energy = 1.5 if is_furnished else 0.5
	_light.directional_shadow_max_distance = 6.0 if is_furnished else 100.0
	for node in _furniture:
		node.queue_free()
	_furniture.clear()
	if not is_furnished:
		return
	# The wall in front is drawn before the mesh, and the one behind it after the mesh.
	_add_wall(Vector3(0.3, 0.2, 0.7), Vector2(0.3, 0.8), Color(0.2, 0.6, 0.3), -1)
	_add_wall(Vector3(0.0, 0.0, -1.5), Vector2(8.0, 8.0), Color(0.7, 0.4, 0.2, 0.5), 1)
	var world := WorldEnvironment.new()
	world.environment = Environment.new()
	world.environment.background_mode = Environment.BG_COLOR
	world.environment.background_color = Color(0.3, 0.4, 0.5)
	world.environment.ambient_light_source = Environment.AMBIENT_SOURCE_COLOR
	world.environment.ambient_light_color = Color(0.8, 0.7, 0.6)
	world.environment.fog_enabled = true
	world.environment.fog_density = 0.05
	_furniture.append(world)
	add_child(world)


func _add_wall(position: Vector3, size: Vector2, colour: Color, priority: int, is_unshaded := true) -> void:
	var wall := MeshInstance3D.new()
	var quad := QuadMesh.new()
	quad.size = size
	wall.mesh = quad
	wall.position = position
	var material := StandardMaterial3D.new()
	material.albedo_color = colour
	if is_unshaded:
		material.shading_mode = BaseMaterial3D.SHADING_MODE_UNSHADED
	if colour.a < 1.0:
		material.transparency = BaseMaterial3D.TRANSPARENCY_ALPHA
	material.render_priority = priority
	wall.material_override = material
	_furniture.append(wall)
	add_child(wall)


func _names_of_joints(state: GLTFState) -> PackedStringArray:
	var found := PackedStringArray()
	for node in state.skins[0].joints_original:
		found.append(state.nodes[node].resource_name)
	return found


func _meshes() -> Array[Node]:
	return _scene.find_children("*", "MeshInstance3D", true, false)


func _pose(asked: Dictionary) -> void:
	var pose: Dictionary = asked.pose
	if pose.has("clip"):
		var player: AnimationPlayer = _scene.find_children("*", "AnimationPlayer", true, false)[0]
		player.play(player.get_animation_list()[pose.clip])
		player.seek(pose.time, true)
		player.pause()
	var turned: Array = pose.get("turned", [])
	for joint in turned.size():
		var skeleton: Skeleton3D = _scene.find_children("*", "Skeleton3D", true, false)[0]
		var turn := Quaternion(turned[joint][1], turned[joint][2], turned[joint][3], turned[joint][0])
		var bone := skeleton.find_bone(_joints[joint])
		skeleton.set_bone_pose_rotation(bone, skeleton.get_bone_pose_rotation(bone) * turn.normalized())
	var morphs: Array = asked.get("morphs", [])
	for shape in morphs.size():
		var mesh: MeshInstance3D = _meshes()[0]
		mesh.set_blend_shape_value(shape, morphs[shape])


func _plain() -> StandardMaterial3D:
	return StandardMaterial3D.new()


func _scattering() -> StandardMaterial3D:
	var material := StandardMaterial3D.new()
	material.resource_name = "skin"
	material.subsurf_scatter_enabled = true
	return material


## A material with a texture for all features, none of which is on, and with the properties asked for. Strings are
## values as Godot writes them.
func _varied(properties: Dictionary) -> BaseMaterial3D:
	var material: BaseMaterial3D = ClassDB.instantiate(properties.get("class", "StandardMaterial3D"))
	material.albedo_color = Color(0.9, 0.8, 0.7, 0.8)
	material.metallic = 0.3
	material.roughness = 0.6
	material.emission = Color(0.5, 0.2, 0.1)
	for texture: BaseMaterial3D.TextureParam in TEXTURES:
		material.set_texture(texture, _texture(texture + 1))
	for name: String in properties:
		if name == "class":
			continue
		var value: Variant = properties[name]
		value = str_to_var(value) if value is String else type_convert(value, typeof(material.get(name)))
		material.set(name, value)
		assert_equal(material.get(name), value)
	return material


## What a user, or the import, may have done to a mesh that the add-on cannot serve then.
func _override(mesh: MeshInstance3D) -> void:
	mesh.material_override = _plain()


func _overlay(mesh: MeshInstance3D) -> void:
	mesh.material_overlay = _plain()


## What a game may do to a mesh that is lit.
func _paint(mesh: MeshInstance3D) -> void:
	_given = _coloured(Color.RED)
	mesh.set_surface_override_material(0, _given)


## Paint it in the last moment of a frame in which scripts run.
func _paint_late(mesh: MeshInstance3D) -> void:
	create_tween().tween_callback(_paint.bind(mesh))


func _unpaint(mesh: MeshInstance3D) -> void:
	_given = null
	mesh.set_surface_override_material(0, null)


func _repaint(mesh: MeshInstance3D) -> void:
	mesh.mesh.surface_set_material(0, _coloured(Color.RED))


func _scatter(mesh: MeshInstance3D) -> void:
	_given = _scattering()
	mesh.set_surface_override_material(0, _given)


func _paint_own(mesh: MeshInstance3D) -> void:
	_given = _own()
	mesh.set_surface_override_material(0, _given)


## Paint it, and later give it the copy back that it had before.
func _flash(mesh: MeshInstance3D) -> void:
	_before = mesh.get_surface_override_material(0)
	_paint(mesh)


func _unflash(mesh: MeshInstance3D) -> void:
	mesh.set_surface_override_material(0, _before)


## Paint it while it is out of the tree, and a frame is drawn.
func _stow(mesh: MeshInstance3D) -> void:
	var skeleton := mesh.get_parent()
	skeleton.remove_child(mesh)
	_paint(mesh)
	RenderingServer.frame_pre_draw.emit()
	skeleton.add_child(mesh)


## Take it out of the scene, and paint it: nothing lights it there.
func _leave(mesh: MeshInstance3D) -> void:
	var skeleton := mesh.get_parent()
	mesh.add_sibling(mesh.duplicate())
	mesh.reparent(self)
	_paint(mesh)
	mesh.skeleton = mesh.get_path_to(skeleton)
	_scene.tree_exited.connect(mesh.queue_free)
	_left = mesh


## Give it its skin and its skeleton again, and so have Godot skin it too.
func _reskin(mesh: MeshInstance3D) -> void:
	var skeleton: Skeleton3D = _scene.find_children("*", "Skeleton3D", true, false)[0]
	mesh.skin = mesh.get_meta(&"skinbake_before").skin
	mesh.skeleton = mesh.get_path_to(skeleton)


func _tint(mesh: MeshInstance3D) -> void:
	mesh.get_active_material(0).set_shader_parameter(&"albedo", Color.BLUE)


func _outline(mesh: MeshInstance3D) -> void:
	mesh.get_active_material(0).next_pass = _coloured(Color.GREEN)


func _reshade(mesh: MeshInstance3D) -> void:
	mesh.get_active_material(0).shader = _foreign().shader


func _lay_bare(mesh: MeshInstance3D) -> void:
	mesh.material_override = null
	mesh.material_overlay = null


func _lose_gradients(mesh: MeshInstance3D) -> void:
	var made := ArrayMesh.new()
	made.resource_name = mesh.mesh.resource_name
	var arrays := mesh.mesh.surface_get_arrays(0)
	for kind: int in [Mesh.ARRAY_CUSTOM0, Mesh.ARRAY_CUSTOM1, Mesh.ARRAY_CUSTOM2]:
		arrays[kind] = null
	made.add_surface_from_arrays(Mesh.PRIMITIVE_TRIANGLES, arrays)
	mesh.mesh = made


func _swap_mesh(mesh: MeshInstance3D) -> void:
	var made := mesh.mesh.duplicate()
	made.resource_name = "another"
	mesh.mesh = made


func _blend_dually(_mesh: MeshInstance3D) -> void:
	_scene.get_node("Skinbake").method = "dqs"


func _blend_linearly(_mesh: MeshInstance3D) -> void:
	_scene.get_node("Skinbake").method = "lbs"


func _apply(_mesh: MeshInstance3D) -> void:
	_scene.get_node("Skinbake").apply()


func _dispose(_mesh: MeshInstance3D) -> void:
	_scene.get_node("Skinbake").dispose()


func _free_node(_mesh: MeshInstance3D) -> void:
	_scene.get_node("Skinbake").free()


func _drop_node(_mesh: MeshInstance3D) -> void:
	_scene.remove_child(_scene.get_node("Skinbake"))


func _free_dropped_node(mesh: MeshInstance3D) -> void:
	var node := _scene.get_node("Skinbake")
	_scene.remove_child(node)
	node.free()


func _free_twin(mesh: MeshInstance3D) -> void:
	mesh.get_node("../twin").free()


func _twin(mesh: MeshInstance3D) -> void:
	var twin: MeshInstance3D = mesh.duplicate()
	twin.name = "twin"
	mesh.add_sibling(twin)
	_apply(mesh)


static func _coloured(colour: Color) -> StandardMaterial3D:
	var material := StandardMaterial3D.new()
	material.albedo_color = colour
	return material


## Put another character below this one, with a mesh of the same name. It is lit by its own node.
func _nest(mesh: MeshInstance3D) -> void:
	var rider := _scene.duplicate()
	mesh.get_parent().add_child(rider)


func _unskin(mesh: MeshInstance3D) -> void:
	mesh.skin = null


func _rescale(mesh: MeshInstance3D) -> void:
	var arrays := mesh.mesh.surface_get_arrays(0)
	for vertex: int in arrays[Mesh.ARRAY_VERTEX].size():
		arrays[Mesh.ARRAY_VERTEX][vertex] *= 2.0
	var format: int = mesh.mesh.surface_get_format(0)
	mesh.mesh.clear_surfaces()
	mesh.mesh.add_surface_from_arrays(Mesh.PRIMITIVE_TRIANGLES, arrays, [], {}, format)


## Copy materials of every kind: Godot parses their shaders at once, and prints what is wrong with them.
func _vary(mesh: MeshInstance3D) -> void:
	for name: String in CHOICES:
		for value: Variant in CHOICES[name]:
			var material := StandardMaterial3D.new()
			material.emission_enabled = name.begins_with("emission")
			material.ao_enabled = name.begins_with("ao")
			if name.begins_with("alpha"):
				material.transparency = BaseMaterial3D.TRANSPARENCY_ALPHA_HASH
			material.set(name, value)
			assert_equal(material.get(name), value)
			_copy(mesh, material)
	_copy(mesh, ORMMaterial3D.new())
	mesh.set_surface_override_material(0, _plain())


func _copy(mesh: MeshInstance3D, material: Material) -> void:
	mesh.set_surface_override_material(0, material)
	var uniforms: Array = Materials.skinning(mesh, 0, []).links[0].copy.shader.get_shader_uniform_list()
	assert_equal(uniforms.any(func(uniform: Dictionary) -> bool: return uniform.name == "albedo"), true)


func assert_equal(found: Variant, wanted: Variant) -> void:
	if found != wanted:
		push_error("skinbake: found %s, wanted %s" % [found, wanted])


## Shaders of the user's own: one that skins, and one that does not.
func _own() -> ShaderMaterial:
	var material := ShaderMaterial.new()
	material.shader = load("res://addons/skinbake/skinbake.gdshader")
	return material


func _foreign() -> ShaderMaterial:
	var material := ShaderMaterial.new()
	material.resource_name = "toon"
	material.shader = Shader.new()
	material.shader.code = "shader_type spatial; void fragment() { ALBEDO = vec3(1.0); }"
	return material


## Every feature that the copies of standard materials have.
func _rich() -> StandardMaterial3D:
	var material := StandardMaterial3D.new()
	material.albedo_color = Color(0.9, 0.8, 0.7, 0.9)
	material.albedo_texture = _texture(1)
	material.metallic = 0.7
	material.metallic_texture = _texture(2)
	material.metallic_texture_channel = BaseMaterial3D.TEXTURE_CHANNEL_BLUE
	material.roughness = 0.6
	material.roughness_texture = _texture(3)
	material.roughness_texture_channel = BaseMaterial3D.TEXTURE_CHANNEL_GREEN
	material.normal_enabled = true
	material.normal_scale = 0.8
	material.normal_texture = _texture(4)
	material.emission_enabled = true
	material.emission = Color(0.1, 0.05, 0.0)
	material.emission_texture = _texture(5)
	material.emission_energy_multiplier = 0.3
	material.ao_enabled = true
	material.ao_light_affect = 0.5
	material.ao_texture = _texture(6)
	material.rim_enabled = true
	material.rim = 0.4
	material.clearcoat_enabled = true
	material.clearcoat = 0.6
	material.grow = true
	material.grow_amount = 0.02
	material.transparency = BaseMaterial3D.TRANSPARENCY_ALPHA_SCISSOR
	material.alpha_scissor_threshold = 0.4
	material.cull_mode = BaseMaterial3D.CULL_DISABLED
	material.texture_filter = BaseMaterial3D.TEXTURE_FILTER_LINEAR
	material.uv1_scale = Vector3(0.5, 0.4, 1.0)
	material.uv1_offset = Vector3(0.1, 0.2, 0.0)
	return material


static func _texture(seed: int) -> ImageTexture:
	var image := Image.create(8, 8, false, Image.FORMAT_RGBA8)
	for pixel in 64:
		var value := fmod(0.37 * pixel * seed, 1.0)
		image.set_pixel(pixel % 8, pixel / 8, Color(0.5 + 0.2 * value, value, 1.0 - 0.5 * value, 0.3 + 0.7 * value))
	image.generate_mipmaps()
	return ImageTexture.create_from_image(image)


func _matrix(transform: Transform3D) -> Array[float]:
	var found: Array[float] = []
	for column in [transform.basis.x, transform.basis.y, transform.basis.z]:
		found.append_array(_numbers(column) + [0.0])
	found.append_array(_numbers(transform.origin) + [1.0])
	return found


static func _numbers(vector: Vector3) -> Array[float]:
	return [vector.x, vector.y, vector.z]
