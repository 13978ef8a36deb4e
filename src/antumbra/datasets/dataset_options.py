"""The options of a data set: the keywords of `antumbra.dataset`."""

from dataclasses import dataclass
from typing import Any

from ..base.checks import flag, listed, whole_number
from ..base.option_fields import Choice, WholeNumber, check_fields, option, same_option
from ..engine.plan import Plan
from ..picture.render_options import EngineOptions, RenderOptions
from ..scene.camera import MAX_SIZE

MOST_FRAMES = 10_000_000
MOST_LIGHTS = 1000

PER_FRAME, PER_SET = "frame", "set"
"""The values of `DatasetOptions.lights_per`."""


def _size(value: Any, what: str) -> tuple[int, int]:
    width, height = listed(value, f"{what} (width, height)", 2)
    return whole_number(width, "picture width", 1, MAX_SIZE), whole_number(height, "picture height", 1, MAX_SIZE)


@dataclass(frozen=True, kw_only=True)
class DatasetOptions:
    """The options of a data set, checked and immutable. Raises InputError."""

    orbit: int = option(
        0, WholeNumber(0, MOST_FRAMES), "Add N cameras around the scene.", metavar="N", hides_limit=True
    )
    """Number of cameras around the scene at equal angles, or inside it if a closed box surrounds everything."""
    random: int = option(
        0, WholeNumber(0, MOST_FRAMES), "Add N random cameras in and around the scene.", metavar="N", hides_limit=True
    )
    """Number of cameras in and around the scene. Each looks at a point in the scene's bounds, sees surfaces, and does
    not stand in a wall."""
    random_lights: int = option(
        0, WholeNumber(0, MOST_LIGHTS), "Add N random lights, alternately a sun and a sphere.", metavar="N"
    )
    """Number of lights, alternately a sun 10 to 80 degrees high and a sphere in free space."""
    lights_per: str = option(
        PER_FRAME, Choice((PER_FRAME, PER_SET)), "Draw random lights for each frame, or once for all of them."
    )
    """What random lights are drawn for. "frame": for each frame, so that they light what its camera sees: where no sun
    does, a sphere in its view takes its place. "set": once, whether they reach what cameras see or not."""
    seed: int = option(0, WholeNumber(0, 2**63 - 1), "Seed of random cameras and lights.", hides_limit=True)
    """Seed of random cameras and lights. Camera k depends only on the scene, the seed and k."""
    size: tuple[int, int] = option(
        (512, 512),
        _size,
        "Picture size in pixels.",
        kind=str,
        start="512x512",
        metavar="WxH",
        is_value=False,
        doc_type="(width, height)",
    )
    """Resolution of all cameras other than `cameras`, in pixels."""
    spp: int = same_option(RenderOptions, "spp")
    sampler: str = same_option(RenderOptions, "sampler")
    time: float = same_option(RenderOptions, "time")
    plan: str | Plan | None = same_option(EngineOptions, "plan", note="")
    threads: int | None = same_option(EngineOptions, "threads")
    max_memory: int | None = same_option(EngineOptions, "max_memory")
    overwrite: bool = option(False, flag, "Replace finished frames, and data sets with other settings.")
    """Render all frames of the shard again. If the folder has a data set with other settings, it is removed."""

    def __post_init__(self) -> None:
        check_fields(self)
