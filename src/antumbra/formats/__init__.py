"""File formats: each module or folder reads or writes one family of formats.

- `format_registry`: all formats with their suffixes, readers and writers
- `gltf/`: glTF 2.0 and GLB
- `obj_file`: OBJ and its materials; `obj_stream`: OBJ files larger than memory, for stores
- `mesh_files`: PLY and STL
- `face_ranges`: meshes of which any faces are read, for stores
- `text_numbers`: numbers in the text of mesh files
- `array_files`: .npy and .npz files, and folders of vertex frames
- `library_meshes`: arrays, and the meshes of trimesh, PyVista, meshio and Open3D
- `example_files`: names of the scenes that come with the package
- `instance_arrays`: scenes of instances from arrays
- `reprojection`: commands that reproject files, for messages
- `json_fields`: checked access to JSON objects
"""
