"""The options of shade along a route, and of calendars of the sun, which their functions take as keywords."""

from dataclasses import dataclass

import numpy as np

from ...base.checks import flag
from ...base.option_fields import Choice, RealNumber, check_fields, option, optional, same_option
from ...engine.plan import Plan
from ...picture.render_options import EngineOptions
from ...sun.location import Place
from ..sensors.curvature_options import CurvatureOptions
from .sun_options import SunKeywords, place_option


@dataclass(frozen=True, kw_only=True)
class RouteOptions:
    """The options of shade along a route, checked and immutable. Raises InputError."""

    place: Place | None = option(None, optional(place_option))
    """None: that of the scene's CRS."""
    step: float = option(
        10.0, RealNumber(1.0 / 60.0, 60.0, "[]", "minutes"), "Interval that each sun position represents."
    )
    """Length of an interval in minutes, up to 60."""
    eye_height: float = option(
        0.0, RealNumber(-np.inf, np.inf), "Height of the stations above the line, in world units."
    )
    """Height of the stations above the line, world units."""
    on_surface: bool = option(False, flag, "First place stations on the highest surface.")
    """First move each station to the highest surface above or below it. Without a surface, it is an error."""
    curvature: bool = same_option(CurvatureOptions, "curvature")
    refraction: float | None = same_option(CurvatureOptions, "refraction")
    earth_radius: float | None = same_option(CurvatureOptions, "earth_radius")
    samples: int = same_option(SunKeywords, "samples")
    plan: str | Plan | None = same_option(SunKeywords, "plan")
    threads: int | None = same_option(EngineOptions, "threads")

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, kw_only=True)
class CalendarOptions:
    """The options of a calendar of the sun, checked and immutable. Raises InputError."""

    place: Place | None = option(None, optional(place_option))
    """None: that of the scene's CRS."""
    step: float = option(
        2.0, RealNumber(1.0 / 60.0, 60.0, "[]", "minutes"), "Interval between the suns that are tried."
    )
    """Minutes between the suns that are tried; shorter gaps of a horizon may be missed. Times are found to a second."""
    sun: str = option("limb", Choice(("limb", "centre")), "The refracted upper limb, or the geometric centre.")
    """"limb": the upper edge of the sun, raised by the refraction of the standard atmosphere, as in almanacs. "centre":
    the centre of its disk, without refraction, as in `antumbra.sun_hours`."""
    eye_height: float = option(0.0, RealNumber(-np.inf, np.inf), "Height of the eyes above the points, in world units.")
    """Height of the eyes above the points, world units."""
    on_surface: bool = option(False, flag, "First place points on the highest surface.")
    """First move each point to the highest surface above or below it. Without a surface, it is an error."""
    curvature: bool = same_option(CurvatureOptions, "curvature")
    refraction: float | None = same_option(CurvatureOptions, "refraction")
    earth_radius: float | None = same_option(CurvatureOptions, "earth_radius")
    plan: str | Plan | None = same_option(SunKeywords, "plan")
    threads: int | None = same_option(EngineOptions, "threads")

    def __post_init__(self) -> None:
        check_fields(self)
