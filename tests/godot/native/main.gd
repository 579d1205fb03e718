extends Node3D
## Draws characters that the editor has imported, as a file of requests asks for, and writes what is seen into a folder.
##
## Light shows normals: one lamp along each axis, each of its own colour, and then the same from the other sides. White
## and matte, a surface sends back the cosines alone.

const Motions := preload("motions.gd")
const AXES := [Vector3.RIGHT, Vector3.UP, Vector3.BACK]
const COLOURS := [Color.RED, Color.GREEN, Color.BLUE]

var _view := SubViewport.new()
var _camera := Camera3D.new()
var _lamps: Array[DirectionalLight3D] = []
var _scene: Node3D


func _ready() -> void:
	var arguments := OS.get_cmdline_user_args()
	var requests: Array = JSON.parse_string(FileAccess.get_file_as_string(arguments[0]))
	_furnish(requests[0].size)
	var told := []
	for number in requests.size():
		told.append(await _drawn(requests[number], arguments[1].path_join(str(number))))
	if RenderingServer.get_current_rendering_method() == "forward_plus":
		await _move(requests[0].file, arguments[1])
	var file := FileAccess.open(arguments[1].path_join("told.json"), FileAccess.WRITE)
	var renderer := RenderingServer.get_current_rendering_method()
	file.store_string(JSON.stringify({"renderer": renderer, "drawn": told}))
	file.close()
	get_tree().quit()


func _furnish(size: float) -> void:
	_view.size = Vector2i(size, size)
	_view.own_world_3d = true
	_view.use_hdr_2d = true
	_view.mesh_lod_threshold = 0.0
	_view.render_target_update_mode = SubViewport.UPDATE_ALWAYS
	add_child(_view)
	var surroundings := WorldEnvironment.new()
	surroundings.environment = Environment.new()
	surroundings.environment.background_mode = Environment.BG_COLOR
	surroundings.environment.background_color = Color.BLACK
	_view.add_child(surroundings)
	_camera.projection = Camera3D.PROJECTION_ORTHOGONAL
	_view.add_child(_camera)
	for axis in AXES.size():
		var lamp := DirectionalLight3D.new()
		lamp.light_color = COLOURS[axis]
		lamp.light_specular = 0.0
		_lamps.append(lamp)
		_view.add_child(lamp)


func _drawn(asked: Dictionary, path: String) -> Dictionary:
	_scene = load("res://" + asked.file).instantiate()
	var meshes := _scene.find_children("*", "MeshInstance3D", true, false)
	var mesh: MeshInstance3D = meshes[0]
	var skin := mesh.skin
	for each: MeshInstance3D in meshes:
		for surface in each.mesh.get_surface_count():
			each.set_surface_override_material(surface, _matte())
	if asked.has("method"):
		_scene.get_node("Skinbake").method = asked.method
	_view.add_child(_scene)
	var report: Array = _scene.get_node("Skinbake").report.duplicate()
	if asked.get("isStandard", false):
		_scene.get_node("Skinbake").dispose()
	for shape in asked.get("morphs", []).size():
		mesh.set_blend_shape_value(shape, asked.morphs[shape])
	_turn(skin, asked.pose.turned)
	# The camera is not turned, so that normals before it are normals in the world.
	var box: AABB = mesh.global_transform * mesh.get_aabb()
	var extent := 1.2 * box.size.length()
	_camera.size = extent
	_camera.near = 0.1 * extent
	_camera.far = 3.0 * extent
	_camera.position = box.get_center() + Vector3(0.0, 0.0, 1.5 * extent)
	_camera.make_current()
	for side: int in [1, -1]:
		for axis in AXES.size():
			var up := Vector3.UP if axis != 1 else Vector3.RIGHT
			_lamps[axis].basis = Basis.looking_at(-side * AXES[axis], up)
		# Pipelines are made, and joints reach the shader, in the frames before.
		for frame in 4:
			await get_tree().process_frame
		await RenderingServer.frame_post_draw
		var image := _view.get_texture().get_image()
		image.convert(Image.FORMAT_RGBF)
		FileAccess.open("%s.%d" % [path, side], FileAccess.WRITE).store_buffer(image.get_data())
	var told := {
		"report": report, "world": _matrix(mesh.global_transform), "extent": extent,
		"centre": [_camera.position.x, _camera.position.y],
	}
	_scene.free()
	return told


## Turn a joint from frame to frame, with Godot's own skinning and then with the add-on's, and write the motion that the
## last frame shows at each pixel.
func _move(file: String, folder: String) -> void:
	var motions := Motions.new()
	_camera.compositor = Compositor.new()
	_camera.compositor.compositor_effects = [motions]
	for lighting: String in ["standard", "accurate"]:
		_scene = load("res://" + file).instantiate()
		_view.add_child(_scene)
		if lighting == "standard":
			_scene.get_node("Skinbake").dispose()
		var skeleton: Skeleton3D = _scene.find_children("*", "Skeleton3D", true, false)[0]
		for frame in 9:
			# It rests in the last two.
			skeleton.set_bone_pose_rotation(1, Quaternion(Vector3.BACK, 0.1 * mini(frame, 6)))
			await RenderingServer.frame_post_draw
			if frame in [6, 8]:
				var path := folder.path_join("%s.%d" % [lighting, frame])
				FileAccess.open(path, FileAccess.WRITE).store_buffer(motions.motions.to_byte_array())
		_scene.free()
	_camera.compositor = null
	motions.free_rids()


static func _matte() -> StandardMaterial3D:
	var found := StandardMaterial3D.new()
	found.diffuse_mode = BaseMaterial3D.DIFFUSE_LAMBERT
	found.specular_mode = BaseMaterial3D.SPECULAR_DISABLED
	return found


func _turn(skin: Skin, turned: Array) -> void:
	var skeleton: Skeleton3D = _scene.find_children("*", "Skeleton3D", true, false)[0]
	for joint in turned.size():
		var turn := Quaternion(turned[joint][1], turned[joint][2], turned[joint][3], turned[joint][0])
		var name := skin.get_bind_name(joint)
		var bone := skin.get_bind_bone(joint) if name.is_empty() else skeleton.find_bone(name)
		skeleton.set_bone_pose_rotation(bone, skeleton.get_bone_pose_rotation(bone) * turn.normalized())


static func _matrix(transform: Transform3D) -> Array[float]:
	var found: Array[float] = []
	for column: Vector3 in [transform.basis.x, transform.basis.y, transform.basis.z]:
		found.append_array([column.x, column.y, column.z, 0.0])
	var origin := transform.origin
	found.append_array([origin.x, origin.y, origin.z, 1.0])
	return found
