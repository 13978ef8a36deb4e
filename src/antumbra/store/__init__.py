"""Scenes in a file of pages: chunks of triangles, each with its BVH. Only chunks that rays reach are in memory.

- layout, meta, directory: the file to the byte; read, write: with checksums
- build, columns, spool, sort, chunks, top, palette: from scenes of any size to a file
- scene, residency, resident: a scene whose chunks come and go within a budget
"""
