"""The page of a bake: its values at vertices, interpolated over the faces, in the colours of heat maps."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..picture.heat_maps import heat_colours, linear_scale
from .scene_page import Page, make_page
from .value_layer import Stop, ValueLayer

_STEPS = 16  # of the colours; between two of them they are straight lines
_LUMINANCE = 0.2126, 0.7152, 0.0722
_NAMES = {
    "ao": ("Visible share of the sky", ""),
    "shadow": ("Visible share of the lights", ""),
    "sun": ("Irradiance of the sun, of its intensity", ""),
    "light": ("Illuminance", "lx"),
    "bent-normal": ("Height of the mean open direction", ""),
}


def baked_page(baked: Any, path: Any, options: dict[str, Any]) -> Page:
    """The page of a `Baked`; options as in `antumbra.Scene.page`."""
    if baked.vertices is None:
        raise InputError("a page shows values at vertices, and a texture was baked; bake without texture")
    scene = baked.vertices.scene
    rows = baked.vertices.values.astype(np.float64)
    values = rows[:, "xyz".index(scene.up)] if baked.what == "bent-normal" else _luminance(rows)
    scale = linear_scale(values)
    ends = np.linspace(0.0, scale.ticks[-1], _STEPS + 1)
    colours = heat_colours(scale.places(ends), 1.0).tolist()
    stops = [Stop(end, f"{end:.4g}", tuple(colour)) for end, colour in zip(ends.tolist(), colours)]
    ticks = [(tick, f"{tick:,.4g}") for tick in scale.ticks.tolist()]
    layer = ValueLayer(*_NAMES[baked.what], values, stops, ticks, corners=baked.vertices.corners)
    return make_page(scene, path, layer=layer, **options)


def _luminance(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """(v,) float64: the values, or the luminance of colours."""
    return rows[:, 0] if rows.shape[1] == 1 else rows @ np.array(_LUMINANCE)
