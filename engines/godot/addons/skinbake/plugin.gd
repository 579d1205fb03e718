@tool
extends EditorPlugin
## Lets the editor's import of glTF files keep what skinbake has baked into them.

const Importer := preload("skinbake_import.gd")

var _importer := Importer.new()


func _enter_tree() -> void:
	GLTFDocument.register_gltf_document_extension(_importer)


func _exit_tree() -> void:
	GLTFDocument.unregister_gltf_document_extension(_importer)
