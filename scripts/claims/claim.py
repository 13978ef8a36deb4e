"""What a claim of a paper is made of."""

from collections.abc import Callable, Sequence
from statistics import median
from typing import Any, NamedTuple

Results = dict[str, Any]
"""The results of a benchmark: the contents of docs/papers/results/NAME.json."""

Condition = str | Callable[[Results], str]
"""What to know about the measurements of a paper, in a sentence or two, perhaps computed from the results."""


class Claim(NamedTuple):
    """A claim of a paper."""

    section: str
    text: str  # with the paper's numbers
    ours: str  # what we found, with the places of `numbers` as in str.format
    numbers: Callable[[Results], Sequence[float]] | None = None
    holds: Callable[..., bool] | None = None  # of the numbers; None: not tried
    reason: str = ""  # why it does not hold or was not tried, as far as known
    remark: str = ""  # said whatever the verdict


def at_size(r: Results, paper: str, field: str = "size") -> str:
    """The size of pictures as text, beside the paper's."""
    size = " x ".join(map(str, r[field]))
    return f"{size} as in the paper" if size == paper else f"{size}, the paper at {paper}"


class Unmeasured(LookupError):
    """The numbers of a claim were not measured, because they would have taken too long."""


def spread(found: Sequence[float]) -> tuple[float, float, float]:
    """The least, the greatest and the median of some numbers; `Unmeasured` if there are none."""
    if not found:
        raise Unmeasured
    return min(found), max(found), median(found)


UNKNOWN = "we do not know why"
NO_GPU = "needs the paper's hardware"
RANGE = "{:.2f} to {:.2f}, median {:.2f}"
"""The text of a `spread`."""
