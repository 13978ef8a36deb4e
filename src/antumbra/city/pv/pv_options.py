"""The options of the shading of modules, which its function takes as keywords."""

from dataclasses import dataclass

from ...base.checks import flag
from ...base.option_fields import Choice, WholeNumber, check_fields, option, optional, same_option
from ...engine.plan import Plan
from ...picture.render_options import EngineOptions
from ...sun.location import Place
from ..sun.sun_options import MOST_SAMPLES, place_option


@dataclass(frozen=True, kw_only=True)
class PvOptions:
    """The options of the shading of modules, checked and immutable. Raises InputError."""

    place: Place | None = option(None, optional(place_option))
    """None: that of the scene's CRS."""
    samples: int = option(16, WholeNumber(1, MOST_SAMPLES), "Points on the sun's disk; 1: its centre.")
    """Points on the sun's disk, 1 to 64; 1: its centre."""
    between: bool = option(True, flag, "Let modules shade each other; not if they are part of SCENE.")
    """Let modules shade each other and each other's sky. False: only the scene does, such as one that has them."""
    per: str = option("module", Choice(("module", "string")), "A series for each module, or for each string.")
    """A series for each module, or for each string of modules."""
    plan: str | Plan | None = same_option(EngineOptions, "plan", note="auto")
    threads: int | None = same_option(EngineOptions, "threads")

    def __post_init__(self) -> None:
        check_fields(self)
