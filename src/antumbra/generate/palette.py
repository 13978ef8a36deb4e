"""The palette of procedural scenes: 32 materials in 8 slightly different shades each; checks of scene size and seed."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from ..base.checks import whole_number
from ..scene.materials import srgb_to_linear

SHADES: Final = 8

_LIGHTNESS = (1.0, 0.93, 1.05, 0.86, 1.1, 0.97, 0.8, 1.02)
_WARMTH = (0.0, 0.02, -0.02, 0.03, 0.0, -0.03, 0.01, 0.04)
_MATERIALS = {
    "LIMESTONE": (228, 209, 176),
    "SANDSTONE": (206, 174, 130),
    "MARBLE": (238, 232, 222),
    "TRAVERTINE": (216, 197, 166),
    "TERRACOTTA": (184, 98, 62),
    "SLATE": (104, 102, 104),
    "OAK": (150, 106, 66),
    "DARK_WOOD": (92, 62, 40),
    "RED": (168, 38, 34),
    "BLUE": (36, 74, 130),
    "OCHRE": (214, 158, 56),
    "LEAF": (76, 118, 48),
    "PINE": (48, 84, 44),
    "LIME": (140, 160, 70),
    "BARK": (98, 78, 60),
    "EARTH": (112, 90, 64),
    "GRASS": (100, 128, 56),
    "ROCK": (134, 130, 122),
    "WATER": (70, 128, 140),
    "BRONZE": (132, 92, 52),
    "IRON": (66, 67, 72),
    "PLASTER": (232, 223, 206),
    "BRICK": (166, 92, 70),
    "CONCRETE": (176, 172, 166),
    "GLASS": (72, 96, 118),
    "ASPHALT": (122, 119, 116),
    "WHITE": (238, 238, 234),
    "YELLOW": (226, 180, 60),
    "TEAL": (84, 134, 128),
    "MOSS": (84, 100, 54),
    "BIRCH": (206, 198, 184),
    "CLAY": (196, 142, 108),
}


def _palette() -> NDArray[np.float32]:
    base = srgb_to_linear(np.array(list(_MATERIALS.values())) / 255.0)[:, None]
    lightness, warmth = np.array(_LIGHTNESS)[:, None], np.array(_WARMTH)[:, None]
    shades = base * lightness * (1.0 + warmth * np.array([1.0, 0.0, -1.0]))
    out: NDArray[np.float32] = np.minimum(shades, 1.0).reshape(-1, 3).astype(np.float32)
    return out


PALETTE: Final = _palette()
"""(256, 3) float32, linear: entry ``material + shade`` with 0 <= shade < 8; shade 0 is the plain material."""

(
    LIMESTONE,
    SANDSTONE,
    MARBLE,
    TRAVERTINE,
    TERRACOTTA,
    SLATE,
    OAK,
    DARK_WOOD,
    RED,
    BLUE,
    OCHRE,
    LEAF,
    PINE,
    LIME,
    BARK,
    EARTH,
    GRASS,
    ROCK,
    WATER,
    BRONZE,
    IRON,
    PLASTER,
    BRICK,
    CONCRETE,
    GLASS,
    ASPHALT,
    WHITE,
    YELLOW,
    TEAL,
    MOSS,
    BIRCH,
    CLAY,
) = range(0, SHADES * len(_MATERIALS), SHADES)


def shades(rng: np.random.Generator, n: int) -> NDArray[np.uint8]:
    """(n,) uint8: random shades to add to a material."""
    return rng.integers(0, SHADES, n, dtype=np.uint8)


# --- Checks of scene size and seed ------------------------------------------------------------------------------------


MIN_TRIANGLES, MAX_TRIANGLES = 1_000, 400_000_000
"""The limits of the number of triangles."""


def check_request(name: str, triangles: object, seed: object) -> tuple[int, int]:
    """`triangles` and `seed` of the scene `name` as integers. Raises InputError if one is invalid."""
    where = f"procedural scene {name}:"
    return (
        whole_number(triangles, f"{where} triangles", MIN_TRIANGLES, MAX_TRIANGLES),
        whole_number(seed, f"{where} seed", 0, 2**63 - 1),
    )
