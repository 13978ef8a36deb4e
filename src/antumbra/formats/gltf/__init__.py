"""glTF 2.0: geometry, node hierarchy, animation, skins, morph targets, cameras and lights, all in float64.

The standard library parses the JSON, and each field is checked on access. pygltflib was rejected: its dataclasses
accept any type for any field, invent defaults for required fields, and take 2.8 s for 0.4 MB that `json` parses in
6 ms.

- `gltf_source`: `read_gltf`, a file as the source of a scene
- `gltf_file`: containers and buffers
- `accessors`: numbers in buffers, including Draco-compressed ones
- `gltf_nodes`: world matrices, keyframes, cameras and lights
- `gltf_meshes`: primitives, skins and morph targets
- `gltf_materials`: base colour, textures and alpha; notes on ignored fields
- `gltf_writer`: GLB files from JSON and arrays
- `gltf_asset`: an editable glTF file, pruned when written
"""
