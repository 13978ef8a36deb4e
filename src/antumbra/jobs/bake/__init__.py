"""Bakes what surfaces receive into glTF files: `antumbra.bake`.

- baking: `bake`, from a scene to a file; options: its arguments; report: what it returns
- sources: the glTF file of any scene; parts: its primitives at their nodes; asset, edit, prune: changes of the file
- measure: rays of all receivers, and values from their bits; hidden: receivers inside solids
- vertices, write_vertices: values at vertices, and their attributes
- charts, texels, textures: texture coordinates, conservative coverage, values of texels; base: colours under the light
- write_textures, images: textures of materials, PNG and EXR
"""

from .bake_job import Baked, bake

__all__ = ["Baked", "bake"]
