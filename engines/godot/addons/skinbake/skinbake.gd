extends Node
## Lights the baked meshes of a scene: skins them in their own shader, with α and β.
##
## The import adds this node to each scene with baked meshes. It works when the scene runs: it takes the skeleton off
## each baked mesh, because Godot skins before vertex(), gives the mesh copies of its materials that skin, and fills
## a texture with the joint matrices whenever the skeleton has a new pose.
## [member report] says for each surface whether it is lit, and if not, why.

const BEFORE := &"skinbake_before"
const Materials := preload("skinbake_material.gd")

## What the import knows of the baked meshes, by their resource names: a dictionary for each surface.
@export var records: Dictionary = {}

## A dictionary for each surface: mesh, surface, lighting ("accurate" or "standard") and reason.
var report: Array[Dictionary] = []

var _poses: Array[Pose] = []


func _ready() -> void:
	apply()


## Light the scene, anew if it was lit before: after materials have changed, or skeletons.
func apply() -> void:
	dispose()
	for mesh: MeshInstance3D in _baked_meshes():
		_light(mesh)
	for entry in report:
		if entry.reason != "":
			push_warning("skinbake: %s, surface %d, stays standard: %s" % [entry.mesh, entry.surface, entry.reason])


## Undo: Godot skins and lights the meshes again.
func dispose() -> void:
	for pose in _poses:
		pose.stop()
	_poses.clear()
	report.clear()
	for mesh: MeshInstance3D in _baked_meshes():
		# In the metadata of the mesh, so that a copy of the scene has it too.
		if not mesh.has_meta(BEFORE):
			continue
		var before: Dictionary = mesh.get_meta(BEFORE)
		mesh.skin = before.skin
		mesh.skeleton = before.skeleton
		mesh.custom_aabb = before.custom_aabb
		for surface in before.materials.size():
			mesh.set_surface_override_material(surface, before.materials[surface])
		mesh.remove_meta(BEFORE)


func _baked_meshes() -> Array[Node]:
	var scene := get_parent()
	var found := scene.find_children("*", "MeshInstance3D", true, false)
	if scene is MeshInstance3D:
		found.push_front(scene)
	return found.filter(
		func(node: MeshInstance3D) -> bool:
			return node.mesh != null and records.has(node.mesh.resource_name) and _is_own(node)
	)


## Whether no other node of this kind lights it: that of a baked scene below this one, as of a rider on a horse.
func _is_own(node: Node) -> bool:
	while node != get_parent():
		if node.get_children().any(func(child: Node) -> bool: return child.get_script() == get_script()):
			return false
		node = node.get_parent()
	return true


func _light(mesh: MeshInstance3D) -> void:
	var surfaces: Array = records[mesh.mesh.resource_name]
	var skeleton := mesh.get_node_or_null(mesh.skeleton) as Skeleton3D
	var materials: Array[ShaderMaterial] = []
	var reasons := PackedStringArray()
	var boxes: Array[AABB] = []
	for surface in surfaces.size():
		var found := Materials.skinning(mesh, surface)
		materials.append(found.material)
		reasons.append(surfaces[surface].why if found.reason == "" else found.reason)
	var hindrance := _hindrance(mesh, skeleton, surfaces, materials)
	if hindrance == "":
		boxes = _boxes(mesh.mesh)
		hindrance = _rescaled(mesh.mesh, surfaces)
	for surface in surfaces.size():
		var reason := hindrance if reasons[surface] == "" else reasons[surface]
		var lighting := "accurate" if reason == "" else "standard"
		report.append({"mesh": _name(mesh), "surface": surface, "lighting": lighting, "reason": reason})
	if hindrance != "":
		return
	var own: Array[Material] = []
	for surface in materials.size():
		own.append(mesh.get_surface_override_material(surface))
	mesh.set_meta(BEFORE, {
		"skin": mesh.skin, "skeleton": mesh.skeleton, "custom_aabb": mesh.custom_aabb, "materials": own
	})
	var pose := _pose_of(skeleton, mesh.skin)
	for surface in materials.size():
		_set_parameters(materials[surface], surfaces[surface], pose.texture)
		mesh.set_surface_override_material(surface, materials[surface])
	# Without a skin: Godot's own skinning would come first, and take the joints and weights away.
	mesh.skin = null
	mesh.skeleton = NodePath()
	pose.add(mesh, boxes)


## Why none of the surfaces of a mesh can be skinned by a shader, "" if they can. Godot skins a mesh as a whole.
func _hindrance(
	mesh: MeshInstance3D, skeleton: Skeleton3D, surfaces: Array, materials: Array[ShaderMaterial]
) -> String:
	if skeleton == null or mesh.skin == null:
		return "the mesh has no skeleton"
	if mesh.material_override != null:
		return "material_override is set: take surface_material_override"
	if mesh.material_overlay != null:
		return "material_overlay is set, and would not be skinned: take next_pass of the materials"
	for surface in materials.size():
		if materials[surface] == null:
			return "the material of surface %d cannot skin" % surface
		var format: int = mesh.mesh.surface_get_format(surface)
		if format & Mesh.ARRAY_FLAG_USE_8_BONE_WEIGHTS or not format & Mesh.ARRAY_FORMAT_BONES:
			return "surface %d has not four influences per vertex" % surface
	if surfaces.all(func(record: Dictionary) -> bool: return record.why != ""):
		return "nothing of it can be lit"
	return ""


## Why the arrays do not fit α and β any more, "" if they do.
func _rescaled(mesh: Mesh, surfaces: Array) -> String:
	for surface in surfaces.size():
		if surfaces[surface].why != "":
			continue
		var now: Vector3 = RenderingServer.mesh_get_surface(mesh.get_rid(), surface).aabb.size
		var before: Vector3 = surfaces[surface].size
		if absf(now.length() - before.length()) > 1e-3 * before.length():
			return "its vertices were scaled at import: leave Root Scale at 1, and scale the node"
	return ""


## The bounding box of what each joint moves, over all surfaces.
static func _boxes(mesh: Mesh) -> Array[AABB]:
	var found: Array[AABB] = []
	for surface in mesh.get_surface_count():
		var boxes: Array = RenderingServer.mesh_get_surface(mesh.get_rid(), surface).get("bone_aabbs", [])
		for joint in boxes.size():
			var box: AABB = boxes[joint]
			if joint == found.size():
				found.append(box)
			elif box.size.x >= 0.0:
				found[joint] = box if found[joint].size.x < 0.0 else found[joint].merge(box)
	return found


func _set_parameters(material: ShaderMaterial, record: Dictionary, joints: Texture2D) -> void:
	while material != null:
		material.set_shader_parameter(&"skinbake_joints", joints)
		# Without α and β the sums that they scale are 0, and the surface is skinned as Godot would.
		material.set_shader_parameter(&"skinbake_scale", record.get("skinbake_scale", 0.0))
		for name: StringName in [&"skinbake_has_tangent_frame", &"skinbake_keeps_frame", &"skinbake_is_morphed"]:
			material.set_shader_parameter(name, record.get(name, false))
		material = material.next_pass as ShaderMaterial


func _pose_of(skeleton: Skeleton3D, skin: Skin) -> Pose:
	for pose in _poses:
		if pose.skeleton == skeleton and pose.skin == skin:
			return pose
	var made := Pose.new(skeleton, skin)
	_poses.append(made)
	return made


func _name(mesh: MeshInstance3D) -> String:
	return str(get_parent().get_path_to(mesh))


## The joint matrices of one skin on one skeleton, and the meshes that they move.
class Pose:
	var skeleton: Skeleton3D
	var skin: Skin
	var texture: ImageTexture

	var _bones := PackedInt32Array()
	var _values := PackedFloat32Array()
	var _meshes: Dictionary[MeshInstance3D, Array] = {}

	func _init(of: Skeleton3D, by: Skin) -> void:
		skeleton = of
		skin = by
		for bind in skin.get_bind_count():
			var name := skin.get_bind_name(bind)
			_bones.append(skin.get_bind_bone(bind) if name.is_empty() else skeleton.find_bone(name))
		_values.resize(12 * _bones.size())
		texture = ImageTexture.create_from_image(_image())
		skeleton.skeleton_updated.connect(update)

	func add(mesh: MeshInstance3D, boxes: Array[AABB]) -> void:
		_meshes[mesh] = boxes
		update()

	func stop() -> void:
		if is_instance_valid(skeleton):
			skeleton.skeleton_updated.disconnect(update)

	## Fill the texture, three rows of a matrix for each joint, and move the bounding boxes.
	func update() -> void:
		var matrices: Array[Transform3D] = []
		for bind in _bones.size():
			var pose := Transform3D.IDENTITY
			if _bones[bind] >= 0:
				pose = skeleton.get_bone_global_pose(_bones[bind]) * skin.get_bind_pose(bind)
			matrices.append(pose)
			for row in 3:
				var at := 12 * bind + 4 * row
				_values[at] = pose.basis.x[row]
				_values[at + 1] = pose.basis.y[row]
				_values[at + 2] = pose.basis.z[row]
				_values[at + 3] = pose.origin[row]
		texture.update(_image())
		for mesh: MeshInstance3D in _meshes:
			if is_instance_valid(mesh):
				mesh.custom_aabb = _bounds(matrices, _meshes[mesh])

	func _image() -> Image:
		return Image.create_from_data(3, _bones.size(), false, Image.FORMAT_RGBAF, _values.to_byte_array())

	static func _bounds(matrices: Array[Transform3D], boxes: Array[AABB]) -> AABB:
		var found := AABB()
		var is_empty := true
		for joint in mini(matrices.size(), boxes.size()):
			if boxes[joint].size.x < 0.0:
				continue
			var box := matrices[joint] * boxes[joint]
			found = box if is_empty else found.merge(box)
			is_empty = false
		return found
