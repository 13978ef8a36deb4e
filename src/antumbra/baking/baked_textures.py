"""Baked textures: their pixels, image files, and places in the materials of a glTF file.

glTF has a slot for occlusion, but none for light. A lightmap is therefore an extension, `MOZ_lightmap`: a texture of
linear irradiance with a UV set of its own, and the factor that turns its values into irradiance. Viewers that do not
know it show the materials as they are.
"""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..base.wording import some_of
from ..formats.gltf.gltf_asset import LIGHTMAP, Asset
from ..formats.gltf.gltf_writer import Json
from ..picture.image_files import write_exr
from ..scene.materials import linear_to_srgb
from .bake_options import BakeOptions
from .baked_values import image_of
from .base_colours import BaseColours
from .texture_atlas import AtlasSheet

# --- Pixels and image files -------------------------------------------------------------------------------------------


_ORDER = np.array([[0, 8, 2, 10], [12, 4, 14, 6], [3, 11, 1, 9], [15, 7, 13, 5]])  # ordered dithering [Bayer 1973]


def encode_pixels(
    image: NDArray[np.floating], bits: int, srgb: bool, dither: bool = False
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """An image (h, w, c) float in [0, 1] as uint8 or uint16.

    srgb : encode its first three channels as sRGB
    dither : round up as often as a value is nearer to the next one, so that dark gradients show no steps
    """
    image = np.clip(image, 0.0, 1.0).astype(np.float64)
    if srgb:
        image[..., :3] = linear_to_srgb(image[..., :3])
    top = (1 << bits) - 1
    if dither:
        h, w = image.shape[:2]
        rounding = np.tile((_ORDER + 0.5) / 16.0, (-(-h // 4), -(-w // 4)))[:h, :w, None]
        pixels = np.floor(top * image + rounding).clip(0, top)
    else:
        pixels = np.round(top * image)
    return pixels.astype(np.uint8) if bits == 8 else pixels.astype(np.uint16)


def save_float_exr(image: NDArray[np.float32], path: Path) -> None:
    """Write an image (h, w, 1 or 3) to a float32 EXR file: channel Y, or R, G, B."""
    image = np.ascontiguousarray(image, np.float32)
    channels = {"Y": np.ascontiguousarray(image[..., 0])} if image.shape[-1] == 1 else {"RGB": image}
    write_exr(channels, path, None)


def image_path(output: Path, number: int, of: int, suffix: str) -> Path:
    """The path of one of several images beside a file."""
    return output.with_name(f"{output.stem}{f'-{number}' if of > 1 else ''}{suffix}")


# --- Materials --------------------------------------------------------------------------------------------------------


def material_image(
    base: BaseColours, sheet: AtlasSheet, values: NDArray[np.floating], originals: Sequence[Json], options: BakeOptions
) -> NDArray[np.float32]:
    """(size, size, c) float32 in [0, 1]: the image of a material, from the values of a sheet's texels.

    base : reads the base colours, if light is multiplied by them
    originals : JSON of each member of the sheet, before edits
    """
    if not options.unlit:
        image = image_of(sheet.cover, values)
        return np.asarray(0.5 + 0.5 * image) if options.what == "bent-normal" else image
    colours = base.texels(sheet, originals)
    colours[:, :3] *= np.clip(values, 0.0, 1.0)
    image = image_of(sheet.cover, colours)
    return image[..., :3] if (colours[:, 3] == 1.0).all() else image


def set_texture(asset: Asset, texture: int, exposure: float, options: BakeOptions, material: Json, uv_set: int) -> None:
    """Assign a baked texture to a material.

    exposure : the factor by which its values were multiplied
    """
    texture_info = {"index": texture, "texCoord": uv_set}
    if options.what == "ao":
        material["occlusionTexture"] = texture_info
    elif options.what == "bent-normal":
        material.setdefault("extras", {})["bentNormalTexture"] = texture_info
    elif options.unlit:
        material.setdefault("pbrMetallicRoughness", {})["baseColorTexture"] = texture_info
        asset.make_unlit(material)
    else:
        full = 1.0 if options.what == "light" else np.pi  # shares of the light: 1 shows the base colour
        material.setdefault("extensions", {})[LIGHTMAP] = {**texture_info, "intensity": full / exposure}
        asset.uses(LIGHTMAP)


def clipping_note(values: NDArray[np.floating], exposure: float) -> list[str]:
    """A note on the texels, (n, c), of which an image holds less than their light."""
    clipped = int((values * exposure > 1.0 + 1e-6).any(-1).sum())
    if not clipped:
        return []
    return [
        f"{some_of(clipped, len(values), 'texel', 'are')} brighter than the image holds; lower exposure, or add exr"
    ]
