"""What a glTF file says about its materials and is left out, in one line."""

import numpy as np

from .fields import Fields

_EXTENSIONS = {
    "transmission": ("KHR_materials_transmission", "KHR_materials_volume", "KHR_materials_diffuse_transmission"),
    "clearcoat": ("KHR_materials_clearcoat",),
    "sheen": ("KHR_materials_sheen",),
    "iridescence": ("KHR_materials_iridescence",),
    "anisotropy": ("KHR_materials_anisotropy",),
    "specular colours": ("KHR_materials_specular",),
}


def left_out(root: Fields) -> list[str]:
    """One note that names the properties of materials that pictures do not show; empty if there are none."""
    found = {name for material in root.objects("materials") for name in _of_material(material)}
    if root.extension("KHR_materials_variants") is not None:
        found.add("variants of materials")
    return [f"{root.where} left out: {', '.join(sorted(found))}; surfaces are diffuse"] if found else []


def _of_material(material: Fields):
    model = material.object("pbrMetallicRoughness")
    if model is not None and ("metallicRoughnessTexture" in model or model.number("metallicFactor", 0.0) > 0.0):
        yield "metalness and roughness"
    if "normalTexture" in material:
        yield "normal maps"
    if "occlusionTexture" in material:
        yield "occlusion maps"
    if "emissiveTexture" in material or np.any(material.numbers("emissiveFactor", 3, np.zeros(3))):
        yield "emission"
    for name, extensions in _EXTENSIONS.items():
        if any(material.extension(extension) is not None for extension in extensions):
            yield name
