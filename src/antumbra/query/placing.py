"""Lights in the frame of a scene, and the ratios of lengths for which the tracers' arithmetic holds."""

from operator import sub

import numpy as np

from ..errors import InputError
from ..scene.light_list import LightList
from ..scene.lights import DIRECTIONAL, Light, LightPatch
from ..scene.recentre import settled

MOST_RATIO = 2.0**120
"""Most widths of the scene between points and lights. Lengths in units of a segment stay in float32's range."""


def place(light: Light, origin: np.ndarray, box: np.ndarray | None, reach: float) -> LightPatch:
    """The patch of a light in the frame whose zero is at the world position `origin`.

    box : (2, 3) float32, around the scene's triangles; None: there are none
    reach : as for `Light.patch`

    Raises
    ------
    InputError
        If points or the light are more than MOST_RATIO widths of the scene away.
    """
    patch = light.patch(origin, reach)
    if isinstance(light, LightList) or patch.kind == DIRECTIONAL:
        _check_ratio(box, max(reach, _farthest(light, patch)), light)
        return patch
    vectors = np.array((patch.base, patch.u, patch.v))
    _check_ratio(box, max(reach, float(np.abs(vectors).max()) + patch.radius), light)
    base, u, v = settled(vectors)
    return LightPatch(patch.kind, base, u, v, patch.w, patch.radius)


def _farthest(light: Light, patch: LightPatch) -> float:
    """The largest magnitude of a coordinate of a list of lights, about; 0 for distant ones, placed by `reach`."""
    if patch.kind == DIRECTIONAL or not isinstance(light, LightList) or not len(light.points):
        return 0.0
    return float(np.abs(light.points).max()) + float(np.abs(patch.base).max())


def _check_ratio(box: np.ndarray | None, far: float, light: Light) -> None:
    if box is None:
        return
    width = max(map(sub, *box[::-1].tolist()))
    if width > 0.0 and far > MOST_RATIO * width:
        raise InputError(
            f"points, or the {type(light).__name__}, are {far:.3g} units away from a scene that is {width:.3g} units "
            f"wide; bring them nearer than {MOST_RATIO:.2g} times its width"
        )
