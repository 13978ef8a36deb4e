"""Lights in the frame of a scene, and the ratios of lengths for which the tracers' arithmetic holds."""

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
    if box is not None:
        _check_ratio(float((box[1].astype(np.float64) - box[0]).max()), max(reach, _farthest(light, patch)), light)
    if isinstance(light, LightList) or patch.kind == DIRECTIONAL:
        return patch
    return patch._replace(base=settled(patch.base), u=settled(patch.u), v=settled(patch.v))


def _farthest(light: Light, patch: LightPatch) -> float:
    """The largest magnitude of a coordinate of the light, about; 0 for distant lights, which are placed by `reach`."""
    if patch.kind == DIRECTIONAL or (isinstance(light, LightList) and not len(light.points)):
        return 0.0
    if isinstance(light, LightList):
        return float(np.abs(light.points).max()) + float(np.abs(patch.base).max())
    return float(np.abs([patch.base, patch.u, patch.v]).max()) + patch.radius


def _check_ratio(width: float, far: float, light: Light) -> None:
    if width > 0.0 and far > MOST_RATIO * width:
        raise InputError(
            f"points, or the {type(light).__name__}, are {far:.3g} units away from a scene that is {width:.3g} units "
            f"wide; bring them nearer than {MOST_RATIO:.2g} times its width"
        )
