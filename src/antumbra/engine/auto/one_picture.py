"""The choices of `auto` for a single picture while its kernels are missing on disk: one tracer and one builder.

Compiling the kernels of all tracers and builders takes longer than a single picture gains from the choice. A process
that makes one picture therefore compiles those of the default fixed plan first (`plan_records.one_picture`), and `auto`
chooses among those. The bits of all choices are equal.
"""

from typing import NamedTuple


class Few(NamedTuple):
    """The only tracer and builder whose kernels are on disk."""

    tracer: str
    builder: str


class Limits:
    """The limits of this process."""

    def __init__(self) -> None:
        self.makes_one_picture = False
        self.few: Few | None = None  # None: `auto` chooses among all


LIMITS = Limits()


def few() -> Few | None:
    """The tracer and builder to which `auto` is limited; None: it chooses among all."""
    return LIMITS.few
