"""The options of view factors: the keywords of `antumbra.view_factors`."""

from dataclasses import dataclass
from typing import Literal

from ...base.option_fields import Choice, WholeNumber, check_fields, option, same_option, unchecked
from ...picture.render_options import EngineOptions, RenderOptions
from ..sensors.surface_groups import Grouping

SIDES = "front", "back"
"""Sides of faces: "front" is the side from which corners run counterclockwise."""

MOST_SAMPLES = 1 << 22
"""Maximum number of rays per surface."""


@dataclass(frozen=True, kw_only=True)
class ViewFactorSurfaces:
    """The surfaces of view factors."""

    per: Grouping = option(
        "surface",
        unchecked,
        "What counts as a surface. surface: a semantic surface of CityJSON, otherwise a planar part of an object.",
        kind=Literal["face", "surface", "object", "building"],
    )
    """As in `surface_groups`."""


@dataclass(frozen=True, kw_only=True)
class ViewFactorKeywords:
    """The keywords of `antumbra.view_factors`, besides those for its input."""

    samples: int = option(4096, WholeNumber(64, MOST_SAMPLES), "Rays per surface, rounded up to a power of two.")
    """Rays per surface, from 64 to 4194304; rounded up to a power of two."""
    side: str = option(
        "front", Choice(SIDES), "Side of faces that radiates. back: for rooms whose faces point outwards."
    )
    """The side of the faces that radiates and receives. "front" is the side from which corners run counterclockwise:
    the outer side of buildings. For a room whose faces point outwards, use "back"."""
    seed: int = option(0, WholeNumber(0, (1 << 63) - 1), "Seed of the sample points.", hides_limit=True)
    """Of the random shifts of the sample points. The same seed gives the same result, with any number of threads."""
    time: float = same_option(RenderOptions, "time", start=0.0)
    threads: int | None = same_option(EngineOptions, "threads")


@dataclass(frozen=True, kw_only=True)
class ViewFactorOptions(ViewFactorKeywords, ViewFactorSurfaces):
    """All options of view factors, checked and immutable. Raises InputError."""

    def __post_init__(self) -> None:
        check_fields(self)
