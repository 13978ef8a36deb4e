"""The options of a skyline: the keywords of `antumbra.skyline`."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...base.checks import flag, number
from ...base.errors import InputError
from ...base.option_fields import RealNumber, check_fields, option, same_option
from ...picture.render_options import EngineOptions, RenderOptions
from ..sensors.curvature_options import CurvatureOptions

_FINEST = 0.01  # degrees
_ROUNDING = 1e-9  # of a number of azimuths


def _step(value: Any, what: str) -> float:
    step = number(value, f"{what} (degrees)", _FINEST, 90.0, "[]")
    if abs(360.0 / step - round(360.0 / step)) > _ROUNDING * 360.0 / step:
        raise InputError(f"{what} (degrees) is {step:g}; it must divide 360, such as 1, 0.5 or 7.5")
    return step


@dataclass(frozen=True, kw_only=True)
class SkylineOptions:
    """The options of a skyline, checked and immutable. Raises InputError."""

    azimuth_step: float = option(1.0, _step, "Angle between azimuths; must divide 360.", metavar="DEGREES")
    """Degrees between azimuths, 0.01 to 90; it must divide 360."""
    north: float | None = option(
        None,
        RealNumber(-360.0, 360.0, "[]", "degrees", optional=True),
        "True north, degrees clockwise from +Y (+Z up) or -Z (+Y up).",
        note="from the CRS, or 0",
        metavar="DEGREES",
    )
    """Direction of true north in degrees, clockwise from the scene's own north axis (+Y if +Z is up, else -Z). None:
    grid convergence of the scene's CRS at its centre, or 0 without a CRS."""
    eye_height: float = option(0.0, RealNumber(-np.inf, np.inf), "Height of the eyes above the points, in world units.")
    """Height of the eyes above the points, world units."""
    on_surface: bool = option(False, flag, "First place points on the highest surface.")
    """First move each point to the highest surface above or below it. Without a surface, it is an error."""
    curvature: bool = same_option(CurvatureOptions, "curvature")
    refraction: float | None = same_option(CurvatureOptions, "refraction")
    earth_radius: float | None = same_option(CurvatureOptions, "earth_radius")
    time: float = same_option(RenderOptions, "time")
    threads: int | None = same_option(EngineOptions, "threads")

    def __post_init__(self) -> None:
        check_fields(self)

    @property
    def count(self) -> int:
        """The number of azimuths."""
        return round(360.0 / self.azimuth_step)
