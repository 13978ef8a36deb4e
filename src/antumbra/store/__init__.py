"""Stores: scenes larger than memory, in one file of chunks. Only chunks that rays reach are in memory.

- `store_format`: the layout of the file, and its metadata
- `store_file`: read and write store files, `StoreData`
- `store_build`: build a file from scenes of any size
- `staging_files`: temporary files of a build
- `chunk_sorting`: Morton order, chunks and their trees
- `chunk_residency`: load and evict chunks within a memory budget
- `system_resources`: disk space, resident memory, reused pages
"""
