"""Bakes what surfaces receive into glTF files: `antumbra.bake`.

- baking: `bake`, from a scene to a file
- sources: the glTF file of any scene; parts: its primitives at their nodes; asset, edit: changes of the file
- measure: rays of all receivers, and values from their bits; hidden: receivers inside solids
- vertices: values at vertices
- charts, texels, textures: texture coordinates, conservative coverage, values of texels; base: colours under the light
- images: PNG and EXR
"""

from .baking import Baked, bake

__all__ = ["Baked", "bake"]
