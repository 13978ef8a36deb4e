"""Lightmaps of glTF files (MOZ_lightmap) in Blender: blender --python blender_lightmap.py -- hall_lit.glb

Materials with a lightmap show their base colour in the baked light, and reflect no other. The lights of the file are
left out, because their light is in the lightmap. In a script: `import_lit("hall_lit.glb")`.
"""

import json
import math
import struct
import sys
import tempfile
from pathlib import Path

import bpy

NAME, INTENSITY = "MOZ_lightmap", "lightmap_intensity"


def import_lit(path):
    """Import a .glb file with its lightmaps; return the materials that have one."""
    known = set(bpy.data.objects), set(bpy.data.materials)
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / Path(path).name
        copy.write_bytes(with_emission(Path(path).read_bytes()))
        bpy.ops.import_scene.gltf(filepath=str(copy), import_pack_images=True)
    for thing in set(bpy.data.objects) - known[0]:
        if thing.type == "LIGHT":
            bpy.data.objects.remove(thing)
    lit = [material for material in bpy.data.materials if material not in known[1] and INTENSITY in material]
    for material in lit:
        show_lightmap(material)
    return lit


def with_emission(data):
    """A GLB file with its lightmaps as emissive textures, which the importer of Blender reads with their UV sets."""
    size = struct.unpack_from("<I", data, 12)[0]
    root, rest = json.loads(data[20 : 20 + size]), data[20 + size :]
    for material in root.get("materials", []):
        lightmap = material.get("extensions", {}).get(NAME)
        if lightmap is not None:
            material["emissiveTexture"] = {"index": lightmap["index"], "texCoord": lightmap.get("texCoord", 1)}
            material["emissiveFactor"] = [1.0, 1.0, 1.0]
            material["extensions"].pop("KHR_materials_emissive_strength", None)
            material.setdefault("extras", {})[INTENSITY] = lightmap.get("intensity", 1.0)
    text = json.dumps(root).encode()
    text += b" " * (-len(text) % 4)
    head = struct.pack("<4sII", b"glTF", 2, 20 + len(text) + len(rest))
    return head + struct.pack("<I4s", len(text), b"JSON") + text + rest


def show_lightmap(material):
    """Show the base colour times the emissive texture, which holds irradiance, and reflect nothing."""
    nodes, links = material.node_tree.nodes, material.node_tree.links
    shader = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    base, emission = shader.inputs["Base Color"], shader.inputs["Emission Color"]
    picture = next(node for node in upstream(emission) if node.type == "TEX_IMAGE")
    picture.image.colorspace_settings.name = "Non-Color"
    product = nodes.new("ShaderNodeVectorMath")
    product.operation = "MULTIPLY"
    if base.is_linked:
        links.new(base.links[0].from_socket, product.inputs[0])
        links.remove(base.links[0])
    else:
        product.inputs[0].default_value = base.default_value[:3]
    links.new(picture.outputs["Color"], product.inputs[1])
    links.new(product.outputs[0], emission)
    base.default_value = (0.0, 0.0, 0.0, 1.0)
    shader.inputs["Emission Strength"].default_value = material[INTENSITY] / math.pi
    shader.inputs["Specular IOR Level"].default_value = 0.0


def upstream(socket):
    """The nodes that lead to a socket."""
    for link in socket.links:
        yield link.from_node
        for each in link.from_node.inputs:
            yield from upstream(each)


if __name__ == "__main__" and "--" in sys.argv:
    import_lit(sys.argv[sys.argv.index("--") + 1])
