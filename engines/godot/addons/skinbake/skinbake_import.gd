@tool
extends GLTFDocumentExtension
## Takes α and β of a baked glTF file into its meshes, and adds a node to the scene that lights them.
##
## α becomes CUSTOM0 and β CUSTOM1, in any encoding and layout of the bake. The node has what the shader needs to
## know of them. In the editor the plugin registers this extension. A game that loads files when it runs does it
## once: see the readme.

const KEY := &"skinbake"
const Lighter := preload("skinbake.gd")

const BYTE := 5120
const SHORT := 5122
const FLOAT := 5126
const SIZES := {BYTE: 1, SHORT: 2, FLOAT: 4}
const TYPES := {"float32": FLOAT, "snorm16": SHORT, "packed8": BYTE}
const LAYOUTS := ["attributes", "custom", "texcoord"]
const REPAIR := ": a tool changed the file after its bake; bake last"
## Of the diagonal, as in skinbake: Draco rounds positions.
const SAME_BOUNDS := 1e-3


func _import_post_parse(state: GLTFState) -> Error:
	var meshes: Array = state.json.get("meshes", [])
	var records := {}
	var stale := _stale(state)
	for index in mini(meshes.size(), state.meshes.size()):
		var primitives: Array = meshes[index]["primitives"]
		var notes := primitives.map(_note_of.bind(state))
		if notes.any(func(note: Dictionary) -> bool: return not note.is_empty()):
			var mesh: ImporterMesh = state.meshes[index].mesh
			records[mesh.resource_name] = _take_in(state, mesh, primitives, notes, stale.get(index, {}))
	state.set_additional_data(KEY, records)
	return OK


func _import_post(state: GLTFState, root: Node) -> Error:
	var records: Dictionary = state.get_additional_data(KEY)
	if not records.is_empty():
		var lighter := Node.new()
		lighter.set_script(Lighter)
		lighter.set(&"records", records)
		lighter.name = "Skinbake"
		root.add_child(lighter)
		lighter.owner = root
	return OK


## The metadata of a bake: those of the primitive, else those of α's accessor; empty if it is not baked.
static func _note_of(primitive: Dictionary, state: GLTFState) -> Dictionary:
	var holders := [primitive]
	var accessors: Array = state.json.get("accessors", [])
	for accessor: float in primitive["attributes"].values():
		holders.append(accessors[int(accessor)])
	for holder: Dictionary in holders:
		var extras: Variant = holder.get("extras")
		if extras is Dictionary and extras.get("skinbake") is Dictionary and extras["skinbake"].has("version"):
			return extras["skinbake"]
	return {}


## By mesh and primitive, why it is lit standard though its metadata are in order: a tool has changed it since its bake,
## as far as the bake has noted what it was, or another part of its skin. Between two lightings, a seam would show.
static func _stale(state: GLTFState) -> Dictionary:
	var found := {}
	var meshes: Array = state.json.get("meshes", [])
	for mesh in meshes.size():
		found[mesh] = {}
		var primitives: Array = meshes[mesh]["primitives"]
		for number in primitives.size():
			var built: ImporterMesh = state.meshes[mesh].mesh if mesh < state.meshes.size() else null
			var is_built := built != null and number < built.get_surface_count()
			var arrays: Array = built.get_surface_arrays(number) if is_built else []
			var change := _change_since(_note_of(primitives[number], state), primitives[number], state, arrays)
			if change != "":
				found[mesh][number] = "a tool has changed %s since its bake: bake last" % change
	var changed := {}
	for is_told: bool in [false, true]:
		for node: Dictionary in state.json.get("nodes", []):
			if not node.has("mesh") or not node.has("skin"):
				continue
			var mesh := int(node["mesh"])
			if not is_told and not found[mesh].is_empty() and not changed.has(node["skin"]):
				changed[node["skin"]] = meshes[mesh].get("name", str(mesh))
			elif is_told and changed.has(node["skin"]):
				for number in meshes[mesh]["primitives"].size():
					if not found[mesh].has(number):
						found[mesh][number] = 'a part of "%s", of the same skin, does not fit its bake: bake last' \
							% changed[node["skin"]]
	return found


## arrays: those of the surface, which Godot has built of it.
static func _change_since(note: Dictionary, primitive: Dictionary, state: GLTFState, arrays: Array) -> String:
	var noted: Variant = note.get("positions")
	if not noted is Dictionary or not primitive["attributes"].has("POSITION"):
		return ""
	var accessors: Array = state.json["accessors"]
	var positions: Dictionary = accessors[int(primitive["attributes"]["POSITION"])]
	if positions["componentType"] != noted.get("componentType"):
		return "the type of its positions"
	var corners: Dictionary = accessors[int(primitive["indices"])] if primitive.has("indices") else positions
	if noted.has("corners") and noted["corners"] != corners["count"]:
		return "its triangles"
	var has_bounds := func(holder: Dictionary) -> bool: return holder.get("min") is Array and holder.get("max") is Array
	if [noted, positions].all(has_bounds):
		var diagonal := _vector(noted["max"]).distance_to(_vector(noted["min"]))
		for key: String in ["min", "max"]:
			var difference := (_vector(noted[key]) - _vector(positions[key])).abs()
			if difference[difference.max_axis_index()] > SAME_BOUNDS * diagonal:
				return "the bounds of its positions"
	if noted.has("joints") and not arrays.is_empty() and noted["joints"] != _sum_of_joints(arrays):
		return "the order of its joints"
	return ""


## The sum over all corners of FNV-1a of a vertex's joints, slot by slot, in 32 bits.
static func _sum_of_joints(arrays: Array) -> int:
	var joints: PackedInt32Array = arrays[Mesh.ARRAY_BONES]
	var count: int = arrays[Mesh.ARRAY_VERTEX].size()
	var hashes := PackedInt64Array()
	hashes.resize(count)
	for vertex in count:
		var hash := 0x811c9dc5
		for at in range(joints.size() / count * vertex, joints.size() / count * (vertex + 1)):
			hash = ((hash ^ joints[at]) * 0x01000193) & 0xffffffff
		hashes[vertex] = hash
	var sum := 0
	if arrays[Mesh.ARRAY_INDEX] == null or arrays[Mesh.ARRAY_INDEX].is_empty():
		for vertex in count:
			sum += hashes[vertex]
	else:
		for vertex: int in arrays[Mesh.ARRAY_INDEX]:
			sum += hashes[vertex]
	return sum & 0xffffffff


static func _vector(numbers: Array) -> Vector3:
	return Vector3(numbers[0], numbers[1], numbers[2])


## Give a mesh the arrays of its bake, and return a record for each surface. stale: as _stale() has it, by primitive.
func _take_in(
	state: GLTFState, mesh: ImporterMesh, primitives: Array, notes: Array, stale: Dictionary
) -> Array[Dictionary]:
	var surfaces: Array[Surface] = []
	var records: Array[Dictionary] = []
	for index in mesh.get_surface_count():
		var surface := Surface.of(mesh, index)
		surfaces.append(surface)
		records.append(_record(state, surface, primitives[index], notes[index], stale.get(index, "")))
	var shapes := range(mesh.get_blend_shape_count()).map(mesh.get_blend_shape_name)
	var mode := mesh.get_blend_shape_mode()
	mesh.clear()
	for shape: String in shapes:
		mesh.add_blend_shape(shape)
	mesh.set_blend_shape_mode(mode)
	for surface in surfaces:
		surface.add_to(mesh)
	return records


## Put α and β into a surface. The record has `why` if they cannot be used.
func _record(
	state: GLTFState, surface: Surface, primitive: Dictionary, note: Dictionary, stale: String
) -> Dictionary:
	if note.is_empty():
		return {"why": "it is not baked"}
	if int(note.get("version", 0)) != 1:
		return {"why": "its bake is of version %s, and this add-on reads version 1" % note.get("version")}
	if not note.get("frame") in ["normal", "tangent"]:
		return {"why": "its frame is %s, and this add-on knows normal and tangent: update it" % note.get("frame")}
	var layout: Variant = note.get("layout", "attributes")
	if not layout in LAYOUTS:
		return {"why": "its layout is %s, and this add-on knows %s: update it" % [layout, ", ".join(LAYOUTS)]}
	if not note.get("encoding", "float32") in TYPES:
		return {"why": "its encoding is %s, and this add-on knows packed8 and snorm16: update it" % note["encoding"]}
	if note.has("encoding") and not (note.get("scale") is float and note["scale"] >= 0.0):
		return {"why": "the metadata of its bake lacks the scale: bake it again"}
	if not _is_sound(note):
		return {"why": "the metadata of its bake is damaged: bake it again"}
	if stale != "":
		return {"why": stale}
	if int(note.get("influences", 4)) > 4:
		return {"why": "it has %d influences per vertex, and a shader of Godot reads four: bake with "
			% int(note["influences"]) + "--limit-influences 4"}
	# Not those of the surface alone: Godot makes tangents where a file has none, and they lie otherwise.
	var has_tangents: bool = primitive["attributes"].has("TANGENT") and surface.array(Mesh.ARRAY_TANGENT) != null
	if note["frame"] == "tangent" and not has_tangents:
		return {"why": "its α and β are along TANGENT, which it has not" + REPAIR}
	if not primitive["attributes"].has("NORMAL") or surface.array(Mesh.ARRAY_NORMAL) == null:
		return {"why": "it has no NORMAL" + REPAIR}
	var stored := Stored.read(state, surface, primitive, note)
	if stored.why != "":
		return {"why": stored.why}
	var is_tangent: bool = note["frame"] == "tangent"
	var is_morphed := not surface.blend_shapes.is_empty()
	surface.set_custom(0, stored.alpha, stored.format)
	surface.set_custom(1, stored.beta, stored.format)
	surface.set_custom(2, null, 0)
	surface.set_custom(3, null, 0)
	if is_morphed or not is_tangent:
		var normals: PackedVector3Array = surface.array(Mesh.ARRAY_NORMAL)
		surface.set_custom(2, normals.to_byte_array().to_float32_array(), Mesh.ARRAY_CUSTOM_RGB_FLOAT)
	if is_morphed and has_tangents:
		surface.set_custom(3, surface.array(Mesh.ARRAY_TANGENT), Mesh.ARRAY_CUSTOM_RGBA_FLOAT)
	return {
		"why": "",
		"skinbake_scale": float(note.get("scale", 1.0)),
		"skinbake_has_tangent_frame": is_tangent,
		"skinbake_keeps_frame": is_morphed or not is_tangent,
		"skinbake_is_morphed": is_morphed,
		"size": surface.bounds().size,
	}


## Whether α and β have as many names as their influences need.
static func _is_sound(note: Dictionary) -> bool:
	var names := {}
	for key: String in ["alpha", "beta"]:
		if not note.get(key) is Array:
			return false
		for name: Variant in note[key]:
			names[name] = name is String
	if false in names.values() or not note.get("influences") is float:
		return false
	if note.get("layout") == "texcoord":
		return names.size() == note["influences"] - 1
	return names.size() == note["influences"] / 2 and note["alpha"].size() == note["beta"].size()


## One surface of an ImporterMesh, taken out so that it can be added again with more arrays.
class Surface:
	var primitive: Mesh.PrimitiveType
	var arrays: Array
	var blend_shapes: Array[Array]
	var lods: Dictionary
	var material: Material
	var name: String
	var format: int

	static func of(mesh: ImporterMesh, index: int) -> Surface:
		var found := Surface.new()
		found.primitive = mesh.get_surface_primitive_type(index)
		found.arrays = mesh.get_surface_arrays(index)
		for shape in mesh.get_blend_shape_count():
			found.blend_shapes.append(mesh.get_surface_blend_shape_arrays(index, shape))
		for lod in mesh.get_surface_lod_count(index):
			found.lods[mesh.get_surface_lod_size(index, lod)] = mesh.get_surface_lod_indices(index, lod)
		found.material = mesh.get_surface_material(index)
		found.name = mesh.get_surface_name(index)
		found.format = mesh.get_surface_format(index)
		return found

	func add_to(mesh: ImporterMesh) -> void:
		mesh.add_surface(primitive, arrays, blend_shapes, lods, material, name, format)

	func array(kind: int) -> Variant:
		var found: Variant = arrays[kind]
		return null if found == null or found.is_empty() else found

	func count() -> int:
		return arrays[Mesh.ARRAY_VERTEX].size()

	## The bounding box of the vertices, blend shapes included.
	func bounds() -> AABB:
		var found := AABB(arrays[Mesh.ARRAY_VERTEX][0], Vector3.ZERO)
		for shape: Array in [arrays] + blend_shapes:
			var vertices: PackedVector3Array = shape[Mesh.ARRAY_VERTEX]
			for vertex in vertices:
				found = found.expand(vertex)
		return found

	## Give up texture coordinates that hold α and β. Those from the third on are overwritten anyway.
	func drop_texcoords(names: Array) -> void:
		for set in 2:
			if "TEXCOORD_%d" % set in names:
				arrays[Mesh.ARRAY_TEX_UV + set] = null
				for shape in blend_shapes:
					shape[Mesh.ARRAY_TEX_UV + set] = null

	func set_custom(number: int, values: Variant, kind: int) -> void:
		var shift := Mesh.ARRAY_FORMAT_CUSTOM0_SHIFT + number * Mesh.ARRAY_FORMAT_CUSTOM_BITS
		arrays[Mesh.ARRAY_CUSTOM0 + number] = values
		format = (format & ~(Mesh.ARRAY_FORMAT_CUSTOM_MASK << shift)) | (kind << shift)


## α and β of one primitive as arrays of Godot.
class Stored:
	var alpha: PackedFloat32Array
	var beta: PackedFloat32Array
	var format := Mesh.ARRAY_CUSTOM_RGB_FLOAT
	var why := ""

	static func read(
		state: GLTFState, surface: Surface, primitive: Dictionary, note: Dictionary
	) -> Stored:
		var found := Stored.new()
		var encoding: String = note.get("encoding", "float32")
		var names: Array = [note["alpha"][0], note["beta"][0]]
		if note.get("layout") == "texcoord":
			names = note["alpha"] + note["beta"].slice(1)
		var pieces: Array[PackedByteArray] = []
		for attribute: String in names:
			pieces.append(found._bytes(state, surface, primitive, attribute, encoding))
		if found.why != "":
			return found
		if note.get("layout") == "texcoord":
			found._assemble(pieces)
			surface.drop_texcoords(names)
		elif encoding != "float32":
			found.format = Mesh.ARRAY_CUSTOM_RGBA_FLOAT
			found.alpha = _unpacked(pieces[0], encoding)
			found.beta = _unpacked(pieces[1], encoding)
		else:
			found.alpha = pieces[0].to_float32_array()
			found.beta = pieces[1].to_float32_array()
		# Godot would refuse the surface, and the mesh would be empty.
		var size := surface.count() * (3 if found.format == Mesh.ARRAY_CUSTOM_RGB_FLOAT else 4)
		if found.alpha.size() != size or found.beta.size() != size:
			found.why = "Godot has changed the number of its vertices in a way that this add-on does not know"
		return found

	## The elements of an attribute for the vertices that Godot has kept, tightly packed.
	func _bytes(
		state: GLTFState, surface: Surface, primitive: Dictionary, attribute: String, encoding: String
	) -> PackedByteArray:
		if not primitive["attributes"].has(attribute):
			why = "it has lost %s%s" % [attribute, REPAIR]
			return PackedByteArray()
		var accessor: GLTFAccessor = state.accessors[int(primitive["attributes"][attribute])]
		var is_float := encoding == "float32"
		var components := 4
		if is_float:
			components = 2 if attribute.begins_with("TEXCOORD_") else 3
		var kind := GLTFAccessor.TYPE_VEC2 + components - 2
		if accessor.component_type != TYPES.get(encoding) or accessor.accessor_type != kind:
			why = "%s has another type than --encoding %s gives it%s" % [attribute, encoding, REPAIR]
		elif accessor.sparse_count > 0 or accessor.buffer_view < 0:
			why = "%s is a sparse accessor, which this add-on does not read%s" % [attribute, REPAIR]
		if why != "":
			return PackedByteArray()
		var size: int = components * SIZES[accessor.component_type]
		var view: GLTFBufferView = state.buffer_views[accessor.buffer_view]
		var data := view.load_buffer_view_data(state)
		var stride := maxi(view.byte_stride, size)
		var kept := Stored._kept(state, surface, primitive, accessor.count)
		if stride == size and kept.is_empty():
			return data.slice(accessor.byte_offset, accessor.byte_offset + size * accessor.count)
		var packed := PackedByteArray()
		for vertex: int in (range(accessor.count) if kept.is_empty() else Array(kept)):
			var start := accessor.byte_offset + vertex * stride
			packed.append_array(data.slice(start, start + size))
		return packed

	## Godot drops vertices that no triangle uses, and keeps the order of the others. Empty: it has kept all.
	static func _kept(
		state: GLTFState, surface: Surface, primitive: Dictionary, count: int
	) -> PackedInt32Array:
		var found := PackedInt32Array()
		if surface.count() == count:
			return found
		if not primitive.has("indices"):
			return _merged(surface, count)
		var accessor: GLTFAccessor = state.accessors[int(primitive["indices"])]
		if accessor.sparse_count > 0 or accessor.buffer_view < 0:
			return found
		var view: GLTFBufferView = state.buffer_views[accessor.buffer_view]
		var data := view.load_buffer_view_data(state)
		var used := {}
		for corner in accessor.count:
			match accessor.component_type:
				5121:
					used[data.decode_u8(accessor.byte_offset + corner)] = true
				5123:
					used[data.decode_u16(accessor.byte_offset + 2 * corner)] = true
				_:
					used[data.decode_u32(accessor.byte_offset + 4 * corner)] = true
		found.append_array(PackedInt32Array(used.keys()))
		found.sort()
		return found

	## In a strip without indices Godot makes equal vertices one. Its indices say which ones: an index for each vertex
	## of the file.
	static func _merged(surface: Surface, count: int) -> PackedInt32Array:
		var found := PackedInt32Array()
		var indices: Variant = surface.array(Mesh.ARRAY_INDEX)
		if indices == null or indices.size() != count:
			return found
		found.resize(surface.count())
		for vertex in range(count - 1, -1, -1):
			found[indices[vertex]] = vertex
		return found

	func _assemble(pieces: Array[PackedByteArray]) -> void:
		var first := pieces[0].to_float32_array()
		var second := pieces[1].to_float32_array()
		var third := pieces[2].to_float32_array()
		var alphas := PackedFloat32Array()
		var betas := PackedFloat32Array()
		for at in range(0, first.size(), 2):
			alphas.append_array([first[at], first[at + 1], second[at]])
			betas.append_array([second[at + 1], third[at], third[at + 1]])
		alpha = alphas
		beta = betas

	## Normalised integers as floats: Godot has no arrays of shorts, and its Compatibility renderer reads only the
	## first of four bytes.
	static func _unpacked(bytes: PackedByteArray, encoding: String) -> PackedFloat32Array:
		var found := PackedFloat32Array()
		if encoding == "packed8":
			found.resize(bytes.size())
			for at in found.size():
				found[at] = maxf(bytes.decode_s8(at) / 127.0, -1.0)
		else:
			found.resize(bytes.size() / 2)
			for at in found.size():
				found[at] = maxf(bytes.decode_s16(2 * at) / 32767.0, -1.0)
		return found
