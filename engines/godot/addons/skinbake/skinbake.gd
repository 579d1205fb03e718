extends Node
## Lights the baked meshes of a scene: skins them in their own shader, with α and β.
##
## The import adds this node to each scene with baked meshes. It works when the scene runs: it takes the skeleton off
## each baked mesh, because Godot skins before vertex(), gives the mesh copies of its materials that skin, and fills
## a texture with the joint matrices whenever the skeleton has a new pose.
## [member report] says for each surface whether it is lit, and if not, why.

const BEFORE := &"skinbake_before"
## How many former copies serve again if a game comes back to their materials: they may have parameters of the game.
const KEPT_COPIES := 8
const Materials := preload("skinbake_material.gd")
const Clock := preload("skinbake_clock.gd")

## What the import knows of the baked meshes, by their resource names: a dictionary for each surface.
@export var records: Dictionary = {}

## How joints are blended: linearly, as Godot does, or by dual quaternions, also where joints scale.
@export_enum("lbs", "dqs") var method := "lbs":
	set(value):
		method = value
		if is_node_ready():
			apply()

## A dictionary for each surface: mesh, surface, lighting ("accurate" or "standard") and reason.
var report: Array[Dictionary] = []

var _poses: Array[Pose] = []
## By mesh, of those that are baked: what decides how it is drawn, as the last look at it has found it.
var _seen: Dictionary = {}
## By mesh: its entries of the report.
var _entries: Dictionary = {}
## By mesh: links of the copies that it had last, by surface.
var _links: Dictionary = {}
var _measured: Dictionary = {}
var _warned: Dictionary = {}


func _ready() -> void:
	apply()


func _enter_tree() -> void:
	# The last moment before a frame is drawn: a game changes materials also in callbacks of tweens and timers.
	RenderingServer.frame_pre_draw.connect(_look)


func _exit_tree() -> void:
	RenderingServer.frame_pre_draw.disconnect(_look)


func _notification(what: int) -> void:
	# Freed alone, and not with its scene.
	if what == NOTIFICATION_PREDELETE and (is_inside_tree() or get_parent() == null):
		_stop()


## Light the scene, anew if it was lit before: after properties of materials have changed, or skeletons.
func apply() -> void:
	dispose()
	for mesh: MeshInstance3D in _baked_meshes():
		_light(mesh, [])
	_tell()


## Undo: Godot skins and lights the meshes again. Materials that were set since then stay.
func dispose() -> void:
	_stop()
	# Those of a copy of the scene, which has the materials of the original.
	for mesh: MeshInstance3D in _baked_meshes():
		_undo(mesh)


func _stop() -> void:
	for pose in _poses:
		pose.stop()
	_poses.clear()
	for mesh in _seen:
		if is_instance_valid(mesh) and _is_lit_here(mesh):
			_undo(mesh)
	_seen.clear()
	_entries.clear()
	_links.clear()
	_measured.clear()
	_warned.clear()
	report.clear()


## Light those meshes anew that were given other materials, another mesh or another skeleton.
func _look() -> void:
	for pose in _poses:
		pose.pass_frame()
	var is_changed := false
	for mesh in _seen.keys():
		if not is_instance_valid(mesh):
			_forget(mesh)
			is_changed = true
		elif not mesh.is_inside_tree():
			continue
		elif _state_of(mesh) != _seen[mesh]:
			_renew(mesh)
			is_changed = true
	if is_changed:
		_tell()


func _renew(mesh: MeshInstance3D) -> void:
	for pose in _poses:
		pose.remove(mesh)
	if (mesh != get_parent() and not get_parent().is_ancestor_of(mesh)) or not _is_own(mesh):
		# It was moved away, perhaps below another character, whose node may light it.
		if _is_lit_here(mesh):
			_undo(mesh)
		_forget(mesh)
		return
	var former: Array = _links.get(mesh, [])
	var links := _undo(mesh)
	for surface in links.size():
		if surface < former.size():
			links[surface].append_array(former[surface].slice(0, KEPT_COPIES))
	_links[mesh] = former if links.is_empty() else links
	_light(mesh, _links[mesh])


func _is_lit_here(mesh: MeshInstance3D) -> bool:
	return mesh.get_meta(BEFORE, {}).get("node") == get_instance_id()


func _forget(mesh: Variant) -> void:
	_seen.erase(mesh)
	_entries.erase(mesh)
	_links.erase(mesh)


## Write the report, and a warning for each surface that stays standard, unless it was warned of.
func _tell() -> void:
	report.clear()
	for entries: Array in _entries.values():
		report.append_array(entries)
	for entry in report:
		if entry.reason == "":
			continue
		var text := "skinbake: %s, surface %d, stays standard: %s" % [entry.mesh, entry.surface, entry.reason]
		if not _warned.has(text):
			_warned[text] = true
			push_warning(text)


## Give a mesh back what it would have without this node, and return the links of its copies, by surface.
static func _undo(mesh: MeshInstance3D) -> Array:
	# In the metadata of the mesh, so that a copy of the scene has it too.
	if not mesh.has_meta(BEFORE):
		return []
	var before: Dictionary = mesh.get_meta(BEFORE)
	mesh.remove_meta(BEFORE)
	# What is not as it was left was set since then, and stays.
	if mesh.skin == null:
		mesh.skin = before.skin
	if mesh.skeleton.is_empty():
		mesh.skeleton = before.skeleton
	mesh.custom_aabb = before.custom_aabb
	for surface in mesh.get_surface_override_material_count():
		var material := mesh.get_surface_override_material(surface)
		if surface < before.links.size() and material == before.links[surface][0].copy:
			var original: Material = before.links[surface][0].source
			material = Materials.as_set(before.links[surface])
			if material == original:
				material = before.materials[surface]
		mesh.set_surface_override_material(surface, Materials.unlit(material))
	return before.links


## All that decides how a mesh is drawn and that a game may set: materials with their shaders and next passes, the
## mesh itself, its skin and its skeleton.
static func _state_of(mesh: MeshInstance3D) -> Array:
	var found := [
		mesh.mesh, mesh.skin, mesh.skeleton, mesh.material_override, mesh.material_overlay, mesh.cast_shadow
	]
	for surface in mesh.get_surface_override_material_count():
		_add_passes(found, mesh.mesh.surface_get_material(surface))
		_add_passes(found, mesh.get_surface_override_material(surface))
	for links: Array in mesh.get_meta(BEFORE, {}).get("links", []):
		_add_passes(found, links[0].source)
	return found


static func _add_passes(found: Array, material: Material) -> void:
	found.append(material)
	while material != null:
		if material is ShaderMaterial:
			found.append(material.shader)
		material = material.next_pass
		found.append(material)


func _baked_meshes() -> Array[Node]:
	var scene := get_parent()
	if scene == null:
		return []
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


## Light a mesh, or note why it stays standard. former: links of copies that may serve again, by surface.
func _light(mesh: MeshInstance3D, former: Array) -> void:
	var surfaces: Array = [] if mesh.mesh == null else records.get(mesh.mesh.resource_name, [])
	var skeleton := mesh.get_node_or_null(mesh.skeleton) as Skeleton3D
	var links: Array[Array] = []
	var reasons := PackedStringArray()
	var boxes: Array[AABB] = []
	var hindrance := _hindrance(mesh, skeleton, surfaces)
	for surface in surfaces.size():
		var why: String = surfaces[surface].why
		if surface < mesh.get_surface_override_material_count():
			var found := Materials.skinning(mesh, surface, former[surface] if surface < former.size() else [])
			links.append(found.links)
			why = why if found.reason == "" else found.reason
			if hindrance == "" and found.reason != "":
				hindrance = "the material of surface %d cannot skin" % surface
		reasons.append(why)
	if hindrance == "":
		# Once for each mesh: it reads the vertices back.
		if not _measured.has(mesh.mesh):
			_measured[mesh.mesh] = {"boxes": _boxes(mesh.mesh), "hindrance": _rescaled(mesh.mesh, surfaces)}
		boxes = _measured[mesh.mesh].boxes
		hindrance = _measured[mesh.mesh].hindrance
	var entries: Array[Dictionary] = []
	for surface in maxi(surfaces.size(), 1):
		var reason := hindrance
		if surface < reasons.size() and reasons[surface] != "":
			reason = reasons[surface]
		var lighting := "accurate" if reason == "" else "standard"
		entries.append({"mesh": _name(mesh), "surface": surface, "lighting": lighting, "reason": reason})
	_entries[mesh] = entries
	if hindrance == "":
		_skin(mesh, skeleton, surfaces, links, boxes)
	_seen[mesh] = _state_of(mesh)


func _skin(
	mesh: MeshInstance3D, skeleton: Skeleton3D, surfaces: Array, links: Array[Array], boxes: Array[AABB]
) -> void:
	var own: Array[Material] = []
	for surface in surfaces.size():
		own.append(mesh.get_surface_override_material(surface))
	mesh.set_meta(BEFORE, {
		"skin": mesh.skin, "skeleton": mesh.skeleton, "custom_aabb": mesh.custom_aabb, "materials": own,
		"links": links, "node": get_instance_id()
	})
	var pose := _pose_of(skeleton, mesh.skin)
	for surface in surfaces.size():
		for link: Dictionary in links[surface]:
			_set_parameters(link.copy, surfaces[surface], pose.texture)
			if pose.has_last:
				link.copy.set_shader_parameter(&"skinbake_clock", Clock.of(mesh.get_viewport()))
			link.copy.set_shader_parameter(
				&"skinbake_has_double_shadow", mesh.cast_shadow == mesh.SHADOW_CASTING_SETTING_DOUBLE_SIDED
			)
		mesh.set_surface_override_material(surface, links[surface][0].copy)
	# Without a skin: Godot's own skinning would come first, and take the joints and weights away.
	mesh.skin = null
	mesh.skeleton = NodePath()
	pose.add(mesh, boxes)


## Why none of the surfaces of a mesh can be skinned by a shader, "" if they can. Godot skins a mesh as a whole.
func _hindrance(mesh: MeshInstance3D, skeleton: Skeleton3D, surfaces: Array) -> String:
	if surfaces.is_empty():
		return "its mesh was replaced by one that is not baked"
	if mesh.mesh.get_surface_count() != surfaces.size():
		return "its mesh has %d surfaces, and %d in the file" % [mesh.mesh.get_surface_count(), surfaces.size()]
	if skeleton == null or mesh.skin == null:
		return "the mesh has no skeleton"
	if mesh.material_override != null:
		return "material_override is set: take surface_material_override"
	if mesh.material_overlay != null:
		return "material_overlay is set, and would not be skinned: take next_pass of the materials"
	for surface in surfaces.size():
		var format: int = mesh.mesh.surface_get_format(surface)
		if format & Mesh.ARRAY_FLAG_USE_8_BONE_WEIGHTS or not format & Mesh.ARRAY_FORMAT_BONES:
			return "surface %d has not four influences per vertex" % surface
		var baked := Mesh.ARRAY_FORMAT_CUSTOM0 | Mesh.ARRAY_FORMAT_CUSTOM1
		if surfaces[surface].get("skinbake_keeps_frame", false):
			baked |= Mesh.ARRAY_FORMAT_CUSTOM2
		if surfaces[surface].why == "" and format & baked != baked:
			return "surface %d has lost α and β, which were CUSTOM0 to CUSTOM2: its mesh was made anew" % surface
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
	material.set_shader_parameter(Materials.IS_LIT, true)
	material.set_shader_parameter(Materials.JOINTS, joints)
	# Without α and β the sums that they scale are 0, and the surface is skinned as Godot would.
	material.set_shader_parameter(&"skinbake_scale", record.get("skinbake_scale", 0.0))
	material.set_shader_parameter(&"skinbake_has_dual_quaternions", method == "dqs")
	for name: StringName in [&"skinbake_has_tangent_frame", &"skinbake_keeps_frame", &"skinbake_is_morphed"]:
		material.set_shader_parameter(name, record.get(name, false))


func _pose_of(skeleton: Skeleton3D, skin: Skin) -> Pose:
	for pose in _poses:
		if pose.skeleton == skeleton and pose.skin == skin:
			return pose
	var made := Pose.new(skeleton, skin, method == "dqs")
	_poses.append(made)
	return made


func _name(mesh: MeshInstance3D) -> String:
	return str(get_parent().get_path_to(mesh))


## The joint matrices of one skin on one skeleton, and the meshes that they move.
class Pose:
	var skeleton: Skeleton3D
	var skin: Skin
	var texture: ImageTexture
	## Whether the texture has the pose of the last frame, too: for motion vectors, which only Forward+ has.
	var has_last := RenderingServer.get_current_rendering_method() == "forward_plus"

	# Keeps Godot's own joint matrices up to date, for the frame in which a mesh is given its skin back.
	var _reference: SkinReference
	var _bones := PackedInt32Array()
	var _is_dual: bool
	var _values := PackedFloat32Array()
	# What the last frame has drawn.
	var _last := PackedFloat32Array()
	var _is_new := false
	var _was_new := false
	var _matrices: Array[Transform3D] = []
	var _meshes: Dictionary = {}

	func _init(of: Skeleton3D, by: Skin, is_dual: bool) -> void:
		skeleton = of
		skin = by
		_is_dual = is_dual
		for bind in skin.get_bind_count():
			var name := skin.get_bind_name(bind)
			_bones.append(skin.get_bind_bone(bind) if name.is_empty() else skeleton.find_bone(name))
		_values.resize(4 * _width() * _bones.size())
		_last = _values.duplicate()
		texture = ImageTexture.create_from_image(_image())
		_reference = skeleton.register_skin(skin)
		skeleton.skeleton_updated.connect(update)
		update()
		_last = _values.duplicate()
		texture.update(_image())

	func add(mesh: MeshInstance3D, boxes: Array[AABB]) -> void:
		_meshes[mesh] = boxes
		# Not by the bones, which have no modifiers now: they have them while skeleton_updated is emitted.
		mesh.custom_aabb = _bounds(boxes)

	func remove(mesh: MeshInstance3D) -> void:
		_meshes.erase(mesh)

	func stop() -> void:
		if is_instance_valid(skeleton):
			skeleton.skeleton_updated.disconnect(update)

	## Fill the texture, and move the bounding boxes.
	func update() -> void:
		_matrices.clear()
		for bind in _bones.size():
			var pose := Transform3D.IDENTITY
			if _bones[bind] >= 0:
				pose = skeleton.get_bone_global_pose(_bones[bind]) * skin.get_bind_pose(bind)
			_matrices.append(pose)
			var texels := _motion(pose) if _is_dual else _rows(pose)
			for texel in texels.size():
				for part in 4:
					_values[4 * (texels.size() * bind + texel) + part] = texels[texel][part]
		texture.update(_image())
		_is_new = true
		for mesh in _meshes:
			if is_instance_valid(mesh):
				mesh.custom_aabb = _bounds(_meshes[mesh])

	## Before a frame is drawn: what it draws is the last pose of the next frame.
	func pass_frame() -> void:
		if not has_last:
			return
		if _was_new and not _is_new:
			texture.update(_image())
		elif _is_new:
			_last = _values.duplicate()
		_was_new = _is_new
		_is_new = false

	func _width() -> int:
		return 5 if _is_dual else 3

	## The rows of a joint matrix.
	static func _rows(pose: Transform3D) -> Array[Vector4]:
		var found: Array[Vector4] = []
		for row in 3:
			found.append(Vector4(pose.basis.x[row], pose.basis.y[row], pose.basis.z[row], pose.origin[row]))
		return found

	## A joint matrix as skinbake_ScaledMotion in the shader: four of moved, then turn, the rotation R in the polar
	## decomposition M = R S, or in that of -M where M mirrors, by Newton's iteration (Higham 1986). A joint that flattens
	## does not mirror. One that leaves a line or a point has no rotation: its columns are those of the matrix, and turn is 0.
	static func _motion(pose: Transform3D) -> Array[Vector4]:
		var columns: Array[Vector3] = [pose.basis.x, pose.basis.y, pose.basis.z, pose.origin]
		var basis := _over(pose.basis, maxf(_length(pose.basis), 1e-30))
		var cofactors := Basis(basis.y.cross(basis.z), basis.z.cross(basis.x), basis.x.cross(basis.y))
		var area := _length(cofactors)
		var turn := Quaternion.IDENTITY
		var length := 0.0
		if area > 1e-6:
			# The cofactors have the same rotation, and an extent where the matrix has none.
			var side := -1.0 if basis.x.dot(cofactors.x) < -1e-6 * area else 1.0
			basis = Basis(side * basis.x + cofactors.x / area, side * basis.y + cofactors.y / area, side * basis.z + cofactors.z / area)
			basis = _over(basis, pow(basis.determinant(), 1.0 / 3.0))
			for step in 12:
				# The volume is at least 1, so the squares sum to 3 where it is a rotation.
				var squares := basis.x.length_squared() + basis.y.length_squared() + basis.z.length_squared()
				var other := basis.inverse().transposed()
				basis = Basis(0.5 * (basis.x + other.x), 0.5 * (basis.y + other.y), 0.5 * (basis.z + other.z))
				if squares < 3.00001:
					break
			turn = basis.orthonormalized().get_rotation_quaternion()
			length = 1.0
		var axis := Vector3(turn.x, turn.y, turn.z)
		var found: Array[Vector4] = []
		for column in columns:
			var moved := turn.w * column + column.cross(axis)
			found.append(Vector4(moved.x, moved.y, moved.z, -column.dot(axis)))
		found.append(length * Vector4(turn.x, turn.y, turn.z, turn.w))
		return found

	static func _length(basis: Basis) -> float:
		return sqrt(basis.x.length_squared() + basis.y.length_squared() + basis.z.length_squared())

	static func _over(basis: Basis, divisor: float) -> Basis:
		return Basis(basis.x / divisor, basis.y / divisor, basis.z / divisor)

	func _image() -> Image:
		var values := _values + _last if has_last else _values
		var rows := values.size() / (4 * _width())
		return Image.create_from_data(_width(), rows, false, Image.FORMAT_RGBAF, values.to_byte_array())

	func _bounds(boxes: Array[AABB]) -> AABB:
		var found := AABB()
		var is_empty := true
		for joint in mini(_matrices.size(), boxes.size()):
			if boxes[joint].size.x < 0.0:
				continue
			var box := _matrices[joint] * boxes[joint]
			found = box if is_empty else found.merge(box)
			is_empty = false
		# Between two joints dual quaternions go along an arc, which bulges out of the box of its ends.
		return found.grow(0.5 * found.get_longest_axis_size()) if _is_dual else found
