"""The tracers ``chcrt:N`` of the aggressive mode [Mattausch et al. 2015, Sec. 7]. They are not exact.

They leave out subtrees that few rays of a tile may meet.
"""

from ...methods import Tracer, by_culling
from ...techniques.tracer_options import ChcRtOptions

THRESHOLDS = 0, 20, 100, 200
"""Thresholds: a subtree is neglected if at most so many rays of a tile may meet it; 0: exact, as in `chcrt`."""


def tracer_name(threshold: int) -> str:
    """The name of the tracer with this threshold."""
    return f"chcrt:{threshold}" if threshold else "chcrt"


def find_aggressive(text: str) -> tuple[str, Tracer] | None:
    """(name, tracer) of an aggressive tracer; None if the name is not one."""
    for n in THRESHOLDS[1:]:
        if text == tracer_name(n):
            about = f"as chcrt, but subtrees that at most {n} rays of a tile may meet are left out: not exact"
            return text, by_culling(ChcRtOptions(threshold=n), about)
    return None
