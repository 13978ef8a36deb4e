"""The tracers ``chcrt:N``, which may neglect what few rays see [Mattausch et al. 2015, Sec. 7]: they are not exact."""

from ...chcrt.options import Options
from ...methods import Tracer, by_culling

THRESHOLDS = 0, 20, 100, 200
"""Rays of a tile that may be neglected; 0: none, as `chcrt` does."""


def tracer_name(threshold: int) -> str:
    """The name of the tracer that may neglect so many rays of a tile."""
    return f"chcrt:{threshold}" if threshold else "chcrt"


def find_aggressive(text: str) -> tuple[str, Tracer] | None:
    """(name, tracer) of one of THRESHOLDS."""
    for n in THRESHOLDS[1:]:
        if text == tracer_name(n):
            about = f"as chcrt, but subtrees that at most {n} rays of a tile may meet are left out: not exact"
            return text, by_culling(Options(threshold=n), about)
    return None
