"""Measures CHC+RT without its parts, and with other parameters [Mattausch et al. 2015, Sec. 4.4, 4.5, 5.1, 5.2, 6]."""

from collections.abc import Iterator
from math import inf

from ...techniques.tracer_options import WHOLE_SCREEN
from . import measure, stores
from .measure import InCore, Pace, Say, Turn
from .rays import AO, DIFFUSE, SAMPLER, SOFT
from .stores import Digests
from .views import WalkPlace

AS_IT_IS = "as it is"
VARIANTS: dict[str, dict] = {
    AS_IT_IS: {},
    "no screen hierarchy": {"tile": WHOLE_SCREEN},
    "no state from frame to frame": {"keep": False},
    "no pull-up": {"pull_up": False},
    "t_q 0.125": {"weight": 0.125},
    "t_q 2": {"weight": 2.0},
    "tiles of 64 pixels": {"tile": 64},
    "tiles of 256 pixels": {"tile": 256},
    "parts of 65,536 triangles": {"triangles": 1 << 16},
    "parts of 4 M triangles": {"triangles": 1 << 22},
}
"""Name -> the options that it changes."""

_MOST = 12  # frames of each variant; they are the first ones of a walkthrough, so its steps are as small
_SHARE = 4  # the walkthrough of a store ends after this part of the time limit


def in_memory(core: InCore, pace: Pace, say: Say) -> Iterator[list[Turn]]:
    """The near walkthrough by all variants, which take turns in each frame."""
    methods = [core.culling_by(name, changed) for name, changed in VARIANTS.items()]
    pace = pace._replace(most=_MOST)
    yield measure.walk_through(core, core.place.walks[0], methods, (AO, DIFFUSE, SOFT), SAMPLER, pace, say)


def out_of_core(
    place: WalkPlace, max_memory: int | None, threads: int, pace: Pace, say: Say
) -> Iterator[tuple[list[Turn], Digests]]:
    """The near walkthrough by each variant, which begins with no chunk in memory.

    The parts of a store are its chunks, so variants with other parts are left out. The others have as many frames as
    the first variant reaches within the time limit.
    """
    pace = pace._replace(most=_MOST, limit=pace.limit / _SHARE)
    for name, changed in VARIANTS.items():
        if "triangles" in changed:
            continue
        with stores.opened(place, max_memory, threads) as paged:
            scheduled = paged.accelerated.prepared
            scheduled.options = scheduled.options._replace(**changed)
            turns, digests = stores.walk_through(place, place.walks[0], paged, name, pace, say)
        pace = pace._replace(most=1 + turns[-1].frame, limit=inf)
        yield turns, digests
