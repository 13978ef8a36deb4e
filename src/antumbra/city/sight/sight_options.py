"""The options of lines of sight, visibility matrices and visible shares, which their functions take as keywords."""

from dataclasses import dataclass

from ...base.checks import flag, whole_number
from ...base.option_fields import check_fields, option, same_option
from ...engine.plan import Plan
from ...picture.render_options import EngineOptions, RenderOptions
from ..sensors.curvature_options import CurvatureOptions

MOST_SAMPLES = 1024
"""Maximum number of samples of a rotor."""


@dataclass(frozen=True, kw_only=True)
class SightOptions:
    """The options of lines of sight, checked and immutable. Raises InputError."""

    time: float = same_option(RenderOptions, "time", start=0.0)
    threads: int | None = same_option(EngineOptions, "threads")

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, kw_only=True)
class MatrixOptions:
    """The options of a visibility matrix, checked and immutable. Raises InputError."""

    plan: str | Plan | None = same_option(EngineOptions, "plan", note="auto")
    time: float = same_option(RenderOptions, "time", start=0.0)
    threads: int | None = same_option(EngineOptions, "threads")

    def __post_init__(self) -> None:
        check_fields(self)


@dataclass(frozen=True, kw_only=True)
class VisibleOptions:
    """The options of the visible share of a target, checked and immutable. Raises InputError."""

    samples: int = option(
        64, lambda value, what: whole_number(value, what, 1, MOST_SAMPLES), "Sample points of the rotor."
    )
    """Samples of a turbine's rotor, 1 to 1024."""
    on_surface: bool = option(False, flag, "First place turbines on the highest surface.")
    """First move the feet of turbines to the highest surface above or below them. Without a surface, it is an error."""
    curvature: bool = same_option(CurvatureOptions, "curvature")
    refraction: float | None = same_option(CurvatureOptions, "refraction")
    earth_radius: float | None = same_option(CurvatureOptions, "earth_radius")
    plan: str | Plan | None = same_option(EngineOptions, "plan", note="auto")
    time: float = same_option(RenderOptions, "time", start=0.0)
    threads: int | None = same_option(EngineOptions, "threads")

    def __post_init__(self) -> None:
        check_fields(self)
