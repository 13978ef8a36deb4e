"""Stores: scenes larger than memory, in one file of chunks. Only chunks that rays reach are in memory.

- layout, meta, directory: the format of the file
- read, write: reading and writing the file, with checksums
- build, space, columns, spool, sort, chunks, top, palette: building a file from scenes of any size
- scene, residency, pool, resident: a scene whose chunks are loaded and evicted within a memory budget
"""
