extends Node3D
## Plays a clip of a file, with none of our code but the add-on where the project has it: window.show(words) loads it,
## and answers in window.answer.

const IMPORT := "res://addons/skinbake/skinbake_import.gd"

var _callback: JavaScriptObject
var _scene: Node3D
var _window := JavaScriptBridge.get_interface("window")


func _ready() -> void:
	if ResourceLoader.exists(IMPORT):
		GLTFDocument.register_gltf_document_extension(load(IMPORT).new())
	var camera := Camera3D.new()
	camera.position.z = 20.0
	add_child(camera)
	camera.make_current()
	add_child(DirectionalLight3D.new())
	_callback = JavaScriptBridge.create_callback(_on_show)
	_window.show = _callback
	_window.isStarted = true


func _on_show(arguments: Array) -> void:
	var asked: Dictionary = JSON.parse_string(arguments[0])
	if _scene != null:
		remove_child(_scene)
		_scene.queue_free()
	_scene = _loaded(asked.path)
	if _scene == null:
		return
	for mesh: MeshInstance3D in _scene.find_children("*", "MeshInstance3D", true, false):
		mesh.custom_aabb = AABB(Vector3.ONE * -1000.0, Vector3.ONE * 2000.0)
		for surface in mesh.mesh.get_surface_count():
			mesh.set_surface_override_material(surface, StandardMaterial3D.new())
		if mesh.name == asked.get("node", ""):
			for target: int in asked.weights.size():
				mesh.set_blend_shape_value(target, asked.weights[target])
	add_child(_scene)
	var player := _player(_scene)
	if asked.get("clips", asked.path) != asked.path:
		var other := _loaded(asked.clips)
		var clips := _player(other).get_animation_library("")
		player.remove_animation_library("")
		player.add_animation_library("", clips)
		other.free()
	player.play(player.get_animation_list()[asked.clip])
	player.seek(asked.time, true)
	player.pause()
	if asked.get("code"):
		var script := GDScript.new()
		script.source_code = "static func run(model: Node) -> void:\n" + asked.code.indent("\t")
		script.reload()
		script.run(_scene)
	_window.answer = ""


func _loaded(path: String) -> Node3D:
	var document := GLTFDocument.new()
	var state := GLTFState.new()
	var error := document.append_from_buffer(FileAccess.get_file_as_bytes(path), "/", state)
	if error != OK:
		_window.answer = error_string(error)
		return null
	return document.generate_scene(state)


func _player(scene: Node) -> AnimationPlayer:
	return scene.find_children("*", "AnimationPlayer", true, false)[0]
