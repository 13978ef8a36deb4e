"""Stores: scenes larger than memory, each in a file of chunks that are read when rays reach them.

- `store_format`: the layout of the file, and its metadata
- `store_checks`: check the structure of what a file says
- `store_file`: open a store, and read its chunks; `store_writer`: write one; `store_directory`: the table of its chunks
- `store_data`: `StoreData`, the scene of a store
- `extended_store`: a store with further faces in memory
- `face_order`: its triangles in the order of faces
- `store_build`: build a file from scenes of any size
- `stored_cutouts`, `stored_heights`, `stored_looks`, `stored_materials`: the sections of a file besides its chunks
- `build_stages`: the stages of a build, and who runs their units; `read_units`: the first stage
- `staging_files`, `staged_looks`: files of a build
- `chunk_sorting`: sort triangles in Morton order, cut them into chunks, and build their trees
- `chunk_residency`: load and evict chunks within a memory budget
- `system_resources`: disk space, resident memory, reused buffers
"""
