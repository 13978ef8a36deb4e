"""Bakes visibility and light on surfaces into glTF files: `antumbra.bake`.

- `bake`: `bake`, from a scene to a file: textures, vertex attributes, image files, and the report
- `bake_options`: quantities and options, with their checks
- `bake_input`: the scene to measure, its lights, and the glTF file to edit
- `converted_scenes`: any scene as a new glTF file; `stored_shapes`: the meshes of a store
- `surface_meter`: rays from all receivers, and values from their occlusion bits
- `bounces`: light that has met surfaces on its way, along paths of diffuse rays
- `emission`: the light that materials emit
- `solids`: which receivers are inside solids
- `baked_values`: values at vertices and texels, and their images
- `baked_textures`: pixels of textures, image files, and the places of textures in materials
- `seams`: edges where charts meet
- `base_colours`: base colours of texels, and what their textures lose
- `texture_atlas`: UV sets or a new atlas, and conservative texel coverage
- `chart_process`: the charts of an atlas, by xatlas in a process of its own
- `bent_surfaces`: finely tessellated smooth surfaces, which xatlas would fold
- `gltf_primitives`: primitives at their nodes, and edits of attributes and materials
- `smooth_normals`: normals of vertices from the faces around them
"""
