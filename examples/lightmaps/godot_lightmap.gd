# Lightmaps of glTF files (MOZ_lightmap) in Godot 4: choose this file as the import script of the
# .glb, and reimport.
#
# Materials with a lightmap show their base colour in the baked light. The lights of the file are
# removed, because their light is in the lightmap. Materials are found by their names, and the
# lightmap must be in the first or second UV set, the only ones that Godot has.
@tool
extends EditorScenePostImport

const NAME := "MOZ_lightmap"
const CODE := """
shader_type spatial;
render_mode unshaded;
uniform vec4 base : source_color = vec4(1.0);
uniform sampler2D base_texture : source_color, hint_default_white, repeat_enable;
uniform vec2 base_scale = vec2(1.0);
uniform vec2 base_offset = vec2(0.0);
uniform sampler2D lightmap : hint_default_white, repeat_disable;
uniform bool second_set = true;
uniform float strength = 1.0;
void fragment() {
	vec3 light = texture(lightmap, second_set ? UV2 : UV).rgb * strength;
	ALBEDO = (base * texture(base_texture, UV * base_scale + base_offset)).rgb * light;
}
"""


func _post_import(scene: Node) -> Object:
	var data := FileAccess.get_file_as_bytes(get_source_file())
	var size := data.decode_u32(12)
	var root: Dictionary = JSON.parse_string(data.slice(20, 20 + size).get_string_from_utf8())
	var shader := Shader.new()
	shader.code = CODE
	var textures := {}
	var lit := {}
	for fields: Dictionary in root.get("materials", []):
		var lightmap: Dictionary = fields.get("extensions", {}).get(NAME, {})
		if lightmap.is_empty():
			continue
		var source := int(root["textures"][int(lightmap["index"])]["source"])
		if not textures.has(source):
			textures[source] = _texture(root, data.slice(28 + size), source)
		lit[fields.get("name", "")] = [lightmap, textures[source]]
	_light(scene, lit, shader)
	return scene


func _texture(root: Dictionary, binary: PackedByteArray, source: int) -> Texture2D:
	var view: Dictionary = root["bufferViews"][int(root["images"][source]["bufferView"])]
	var start := int(view.get("byteOffset", 0))
	var image := Image.new()
	image.load_png_from_buffer(binary.slice(start, start + int(view["byteLength"])))
	image.generate_mipmaps()
	return ImageTexture.create_from_image(image)


func _light(node: Node, lit: Dictionary, shader: Shader) -> void:
	for child in node.get_children():
		_light(child, lit, shader)
		if child is Light3D:
			node.remove_child(child)
			child.queue_free()
	if node is MeshInstance3D:
		for surface in node.mesh.get_surface_count():
			var old: Material = node.mesh.surface_get_material(surface)
			if old is BaseMaterial3D and lit.has(old.resource_name):
				node.mesh.surface_set_material(surface, _material(old, lit[old.resource_name], shader))


func _material(old: BaseMaterial3D, found: Array, shader: Shader) -> ShaderMaterial:
	var material := ShaderMaterial.new()
	material.resource_name = old.resource_name
	material.shader = shader
	material.set_shader_parameter("base", old.albedo_color)
	material.set_shader_parameter("base_texture", old.albedo_texture)
	material.set_shader_parameter("base_scale", Vector2(old.uv1_scale.x, old.uv1_scale.y))
	material.set_shader_parameter("base_offset", Vector2(old.uv1_offset.x, old.uv1_offset.y))
	material.set_shader_parameter("lightmap", found[1])
	material.set_shader_parameter("second_set", int(found[0].get("texCoord", 1)) == 1)
	material.set_shader_parameter("strength", float(found[0].get("intensity", 1.0)) / PI)
	return material
