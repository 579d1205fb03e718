extends RefCounted
## Copies of materials that skin: standard materials as variants of one shader, others if they include it.

const PATH := "res://addons/skinbake/"
const JOINTS := &"skinbake_joints"
const IS_LIT := &"skinbake_is_lit"

## Features of standard materials that the shader has not.
const FEATURES := {
	BaseMaterial3D.FEATURE_HEIGHT_MAPPING: "height mapping",
	BaseMaterial3D.FEATURE_ANISOTROPY: "anisotropy",
	BaseMaterial3D.FEATURE_SUBSURFACE_SCATTERING: "subsurface scattering",
	BaseMaterial3D.FEATURE_SUBSURFACE_TRANSMITTANCE: "transmittance",
	BaseMaterial3D.FEATURE_BACKLIGHT: "backlight",
	BaseMaterial3D.FEATURE_REFRACTION: "refraction",
	BaseMaterial3D.FEATURE_DETAIL: "detail",
}
const FLAGS := {
	BaseMaterial3D.FLAG_UV1_USE_TRIPLANAR: "triplanar mapping",
	BaseMaterial3D.FLAG_UV2_USE_TRIPLANAR: "triplanar mapping",
	BaseMaterial3D.FLAG_USE_POINT_SIZE: "a point size",
	BaseMaterial3D.FLAG_FIXED_SIZE: "a fixed size",
	BaseMaterial3D.FLAG_ALBEDO_TEXTURE_MSDF: "an MSDF texture",
	BaseMaterial3D.FLAG_PARTICLE_TRAILS_MODE: "particle trails",
}
const BLEND := ["blend_mix", "blend_add", "blend_sub", "blend_mul", "blend_premul_alpha"]
const DEPTH := ["depth_draw_opaque", "depth_draw_always", "depth_draw_never"]
const CULL := ["cull_back", "cull_front", "cull_disabled"]
const DIFFUSE := ["diffuse_burley", "diffuse_lambert", "diffuse_lambert_wrap", "diffuse_toon"]
const SPECULAR := ["specular_schlick_ggx", "specular_toon", "specular_disabled"]
const MODES := {
	BaseMaterial3D.FLAG_DISABLE_DEPTH_TEST: "depth_test_disabled",
	BaseMaterial3D.FLAG_USE_SHADOW_TO_OPACITY: "shadow_to_opacity",
	BaseMaterial3D.FLAG_DONT_RECEIVE_SHADOWS: "shadows_disabled",
	BaseMaterial3D.FLAG_DISABLE_AMBIENT_LIGHT: "ambient_light_disabled",
	BaseMaterial3D.FLAG_DISABLE_FOG: "fog_disabled",
	BaseMaterial3D.FLAG_DISABLE_SPECULAR_OCCLUSION: "specular_occlusion_disabled",
}
const ALPHA_ANTIALIASING: Dictionary[BaseMaterial3D.AlphaAntiAliasing, String] = {
	BaseMaterial3D.ALPHA_ANTIALIASING_ALPHA_TO_COVERAGE: "alpha_to_coverage",
	BaseMaterial3D.ALPHA_ANTIALIASING_ALPHA_TO_COVERAGE_AND_TO_ONE: "alpha_to_coverage_and_one",
}
const FILTERS := [
	"filter_nearest", "filter_linear", "filter_nearest_mipmap", "filter_linear_mipmap",
	"filter_nearest_mipmap_anisotropic", "filter_linear_mipmap_anisotropic",
]
const CHANNELS := [
	Vector4(1, 0, 0, 0), Vector4(0, 1, 0, 0), Vector4(0, 0, 1, 0), Vector4(0, 0, 0, 1),
	Vector4(1 / 3.0, 1 / 3.0, 1 / 3.0, 0),
]

static var _shaders: Dictionary[String, Shader] = {}


static var _default := StandardMaterial3D.new()


## The result for one material: links for it and its next passes, or the reason why there are none. A link has the
## source, the copy that skins, and the shader of the copy.
class Result:
	var links: Array[Dictionary] = []
	var reason := ""


## Make a copy of the material of a surface that skins. Copies of the same sources in former links serve again.
static func skinning(mesh: MeshInstance3D, surface: int, former: Array) -> Result:
	var material := mesh.get_surface_override_material(surface)
	if material == null:
		material = mesh.mesh.surface_get_material(surface)
	var found := Result.new()
	_add_link(found, _default if material == null else material, former)
	return found


## What a game has made of copies: the source of the first, if it has left them all alone. Next passes that it has
## set on a copy are put on a duplicate of the source, which is the new source then.
static func as_set(links: Array, at := 0) -> Material:
	var link: Dictionary = links[at]
	if link.copy.shader != link.shader:
		return link.copy
	var next: Material = link.copy.next_pass
	var following: Dictionary = links[at + 1] if at + 1 < links.size() else {}
	if next == following.get("copy"):
		if next == null:
			return link.source
		var source: Material = following.source
		next = as_set(links, at + 1)
		if next == source:
			return link.source
	link.source = link.source.duplicate()
	link.source.next_pass = next
	return link.source


## A material for Godot's own skinning. What a game has set may be a copy that skins, of this mesh or another one.
static func unlit(material: Material) -> Material:
	if material == null:
		return null
	var next := unlit(material.next_pass)
	var is_lit: bool = material is ShaderMaterial and material.get_shader_parameter(IS_LIT) == true
	if next == material.next_pass and not is_lit:
		return material
	var found: Material = material.duplicate()
	found.next_pass = next
	if is_lit:
		found.set_shader_parameter(IS_LIT, false)
	return found


static func _add_link(found: Result, material: Material, former: Array) -> void:
	var copy: ShaderMaterial
	if material is ShaderMaterial:
		if not _skins(material):
			found.reason = ("its shader %s does not include %sskinbake.gdshaderinc, or does not call skinbake_vertex()"
				% [_called(material), PATH])
			return
		copy = _former(former, material, material.shader)
		if copy == null:
			copy = material.duplicate()
	elif material is BaseMaterial3D:
		found.reason = _missing(material)
		if found.reason != "":
			return
		var shader := _variant(material)
		copy = _former(former, material, shader)
		if copy == null:
			copy = _copied(material, shader)
	else:
		found.reason = "its material %s is a %s" % [_called(material), material.get_class()]
		return
	found.links.append({"source": material, "copy": copy, "shader": copy.shader})
	var count := found.links.size()
	if material.next_pass != null:
		_add_link(found, material.next_pass, former)
	copy.next_pass = found.links[count].copy if count < found.links.size() else null


## The copy of a material in former links. A game may have given it parameters.
static func _former(former: Array, material: Material, shader: Shader) -> ShaderMaterial:
	for link: Dictionary in former:
		if link.source == material and link.copy.shader == shader:
			return link.copy
	return null


static func _skins(material: ShaderMaterial) -> bool:
	if material.shader == null:
		return false
	return material.shader.get_shader_uniform_list().any(
		func(uniform: Dictionary) -> bool: return uniform.name == JOINTS
	)


static func _called(material: Material) -> String:
	var name := material.resource_name if material.resource_name != "" else material.resource_path
	return "\"%s\"" % name


static func _missing(material: BaseMaterial3D) -> String:
	var names := PackedStringArray()
	for feature: BaseMaterial3D.Feature in FEATURES:
		if material.get_feature(feature):
			names.append(FEATURES[feature])
	for flag: BaseMaterial3D.Flags in FLAGS:
		if material.get_flag(flag):
			names.append(FLAGS[flag])
	if material.billboard_mode != BaseMaterial3D.BILLBOARD_DISABLED:
		names.append("a billboard")
	if material.proximity_fade_enabled or material.distance_fade_mode != BaseMaterial3D.DISTANCE_FADE_DISABLED:
		names.append("a fade")
	if material.get_feature(BaseMaterial3D.FEATURE_BENT_NORMAL_MAPPING):
		names.append("bent normals")
	if material.stencil_mode != BaseMaterial3D.STENCIL_MODE_DISABLED:
		names.append("a stencil")
	if names.is_empty():
		return ""
	return ("its material %s has %s, which skinbake's shader has not: use a shader of your own that includes "
		% [_called(material), ", ".join(names)] + PATH + "skinbake.gdshaderinc")


static func _variant(material: BaseMaterial3D) -> Shader:
	var code := "shader_type spatial;\nrender_mode %s;\n" % ", ".join(_modes(material))
	for define: String in _defines(material):
		code += "#define %s\n" % define
	for include: String in ["skinbake.gdshaderinc", "skinbake_material.gdshaderinc"]:
		code += "#include \"%s%s\"\n" % [PATH, include]
	if not _shaders.has(code):
		_shaders[code] = Shader.new()
		_shaders[code].code = code
	return _shaders[code]


static func _copied(material: BaseMaterial3D, shader: Shader) -> ShaderMaterial:
	var made := ShaderMaterial.new()
	made.resource_name = material.resource_name
	made.render_priority = material.render_priority
	made.shader = shader
	_set_parameters(made, material)
	return made


static func _modes(material: BaseMaterial3D) -> PackedStringArray:
	var found := PackedStringArray([
		BLEND[material.blend_mode], DEPTH[material.depth_draw_mode], CULL[material.cull_mode],
		DIFFUSE[material.diffuse_mode], SPECULAR[material.specular_mode],
	])
	if material.transparency == BaseMaterial3D.TRANSPARENCY_ALPHA_DEPTH_PRE_PASS:
		found.append("depth_prepass_alpha")
	if material.shading_mode == BaseMaterial3D.SHADING_MODE_UNSHADED:
		found.append("unshaded")
	elif material.shading_mode == BaseMaterial3D.SHADING_MODE_PER_VERTEX:
		found.append("vertex_lighting")
	if material.depth_test == BaseMaterial3D.DEPTH_TEST_INVERTED and not material.no_depth_test:
		found.append("depth_test_inverted")
	if _antialiases_alpha(material):
		found.append(ALPHA_ANTIALIASING[material.alpha_antialiasing_mode])
	for flag: BaseMaterial3D.Flags in MODES:
		if material.get_flag(flag):
			found.append(MODES[flag])
	return found


static func _antialiases_alpha(material: BaseMaterial3D) -> bool:
	return (
		material.alpha_antialiasing_mode != BaseMaterial3D.ALPHA_ANTIALIASING_OFF
		and material.transparency in [
			BaseMaterial3D.TRANSPARENCY_ALPHA_SCISSOR, BaseMaterial3D.TRANSPARENCY_ALPHA_HASH,
		]
	)


static func _defines(material: BaseMaterial3D) -> PackedStringArray:
	var repeats := material.get_flag(BaseMaterial3D.FLAG_USE_TEXTURE_REPEAT)
	var found := PackedStringArray([
		"SAMPLING %s, %s" % [FILTERS[material.texture_filter], "repeat_enable" if repeats else "repeat_disable"],
	])
	for feature: Array in [
		[BaseMaterial3D.FEATURE_NORMAL_MAPPING, "NORMAL_MAPPED"],
		[BaseMaterial3D.FEATURE_AMBIENT_OCCLUSION, "OCCLUDED"],
		[BaseMaterial3D.FEATURE_RIM, "RIMMED"],
		[BaseMaterial3D.FEATURE_CLEARCOAT, "COATED"],
	]:
		if material.get_feature(feature[0]):
			found.append(feature[1])
	if material.get_feature(BaseMaterial3D.FEATURE_EMISSION):
		var adds := material.emission_operator == BaseMaterial3D.EMISSION_OP_ADD
		found.append("EMISSIVE_ADDED" if adds else "EMISSIVE_MULTIPLIED")
	for flag: Array in [
		[BaseMaterial3D.FLAG_ALBEDO_FROM_VERTEX_COLOR, "VERTEX_COLOURED"],
		[BaseMaterial3D.FLAG_SRGB_VERTEX_COLOR, "VERTEX_COLOUR_SRGB"],
		[BaseMaterial3D.FLAG_ALBEDO_TEXTURE_FORCE_SRGB, "ALBEDO_SRGB"],
		[BaseMaterial3D.FLAG_EMISSION_ON_UV2, "EMISSIVE_ON_UV2"],
		[BaseMaterial3D.FLAG_USE_Z_CLIP_SCALE, "Z_CLIP_SCALED"],
		[BaseMaterial3D.FLAG_USE_FOV_OVERRIDE, "FOV_OVERRIDDEN"],
	]:
		if material.get_flag(flag[0]):
			found.append(flag[1])
	# The ORM texture is on UV, whatever the flag says.
	if material.get_flag(BaseMaterial3D.FLAG_AO_ON_UV2) and not material is ORMMaterial3D:
		found.append("OCCLUDED_ON_UV2")
	# Godot scales UV2 for the detail layer alone, whether it is on or not.
	if material.detail_uv_layer == BaseMaterial3D.DETAIL_UV_2:
		found.append("UV2_SCALED")
	if material.shading_mode == BaseMaterial3D.SHADING_MODE_PER_VERTEX:
		found.append("VERTEX_LIT")
	if _antialiases_alpha(material):
		found.append("ALPHA_ANTIALIASED")
	if material.grow:
		found.append("GROWN")
	match material.transparency:
		BaseMaterial3D.TRANSPARENCY_ALPHA_SCISSOR:
			found.append_array(["TRANSPARENT", "SCISSORED"])
		BaseMaterial3D.TRANSPARENCY_ALPHA_HASH:
			found.append_array(["TRANSPARENT", "HASHED"])
		BaseMaterial3D.TRANSPARENCY_ALPHA, BaseMaterial3D.TRANSPARENCY_ALPHA_DEPTH_PRE_PASS:
			found.append("TRANSPARENT")
		_ when material.shadow_to_opacity:
			found.append("TRANSPARENT")
	# Godot draws the shadows of all other materials by one of its own, which culls back faces. Forward+ does not
	# where they are not culled.
	var is_its_own := ["TRANSPARENT", "GROWN", "Z_CLIP_SCALED", "FOV_OVERRIDDEN"].any(found.has)
	if material.cull_mode == BaseMaterial3D.CULL_DISABLED and not is_its_own:
		found.append("SHADOW_BY_FRONT")
	return found


## Give the copy the values of the material, under the names that Godot's own shaders have for them.
static func _set_parameters(made: ShaderMaterial, material: BaseMaterial3D) -> void:
	for name: StringName in [
		&"metallic", &"roughness", &"normal_scale", &"rim", &"rim_tint", &"clearcoat", &"clearcoat_roughness",
		&"ao_light_affect", &"alpha_scissor_threshold", &"alpha_hash_scale", &"alpha_antialiasing_edge",
		&"uv1_scale", &"uv1_offset", &"uv2_scale", &"uv2_offset", &"emission", &"z_clip_scale", &"fov_override",
	]:
		made.set_shader_parameter(name, material.get(name))
	made.set_shader_parameter(&"albedo", material.albedo_color)
	made.set_shader_parameter(&"specular", material.metallic_specular)
	made.set_shader_parameter(&"grow", material.grow_amount)
	made.set_shader_parameter(&"emission_energy", material.emission_energy_multiplier)
	if material.albedo_texture != null:
		var size := Vector2i(material.albedo_texture.get_width(), material.albedo_texture.get_height())
		made.set_shader_parameter(&"albedo_texture_size", size)
	for kind: Array in [
		[BaseMaterial3D.TEXTURE_ALBEDO, &"texture_albedo"],
		[BaseMaterial3D.TEXTURE_METALLIC, &"texture_metallic"],
		[BaseMaterial3D.TEXTURE_ROUGHNESS, &"texture_roughness"],
		[BaseMaterial3D.TEXTURE_NORMAL, &"texture_normal"],
		[BaseMaterial3D.TEXTURE_EMISSION, &"texture_emission"],
		[BaseMaterial3D.TEXTURE_AMBIENT_OCCLUSION, &"texture_ambient_occlusion"],
		[BaseMaterial3D.TEXTURE_RIM, &"texture_rim"],
		[BaseMaterial3D.TEXTURE_CLEARCOAT, &"texture_clearcoat"],
	]:
		made.set_shader_parameter(kind[1], material.get_texture(kind[0]))
	made.set_shader_parameter(&"metallic_texture_channel", CHANNELS[material.metallic_texture_channel])
	made.set_shader_parameter(&"roughness_texture_channel", CHANNELS[material.roughness_texture_channel])
	made.set_shader_parameter(&"ao_texture_channel", CHANNELS[material.ao_texture_channel])
	if material is ORMMaterial3D:
		var packed := material.get_texture(BaseMaterial3D.TEXTURE_ORM)
		var channels := {&"texture_ambient_occlusion": 0, &"texture_roughness": 1, &"texture_metallic": 2}
		for name: StringName in channels:
			made.set_shader_parameter(name, packed)
		made.set_shader_parameter(&"ao_texture_channel", CHANNELS[0])
		made.set_shader_parameter(&"roughness_texture_channel", CHANNELS[1])
		made.set_shader_parameter(&"metallic_texture_channel", CHANNELS[2])
		made.set_shader_parameter(&"roughness", 1.0)
		made.set_shader_parameter(&"metallic", 1.0)
		made.set_shader_parameter(&"specular", 0.5)
