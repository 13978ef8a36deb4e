"""What long work will take: judged by a sample before it begins, else by its second unit.

The first unit, and the first piece of a sample, also load kernels and build trees.
"""

import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import NamedTuple

from ..base.errors import InputError
from ..base.memory import available_memory, readable_size
from ..base.progress import LOG
from ..base.wording import agreeing, counted
from .result_summary import duration

JUDGED = 2
"""The unit by which the others are judged without a sample, counted from 1 among those that this process does."""

_LONG = 60.0  # seconds of work whose estimate is told

_tell: ContextVar[Callable[[str], object]] = ContextVar("antumbra_estimates", default=LOG.info)


@contextmanager
def telling(tell: Callable[[str], object]) -> Iterator[None]:
    """Within the context, a function gets the estimates, each a line of text; else they are logged."""
    token = _tell.set(tell)
    try:
        yield
    finally:
        _tell.reset(token)


class Estimate(NamedTuple):
    """What a unit takes, judged by some that is done."""

    seconds: float
    size: float  # bytes of its files
    memory: float  # bytes of a process that does it
    more: float  # of these, bytes that the judging process does not have yet
    source: str  # what it is judged by


def tell_estimate(what: str, folder: Path | None, unit: Estimate, left: int, by: str = "") -> None:
    """Tell what the units that are left will take, if that is a minute or more.

    folder : of their files; None: in memory
    by : who does them, if not this process

    Raises
    ------
    InputError
        If their files do not fit on the disk, or a process does not fit in memory.
    """
    if not left:
        return
    size = left * unit.size
    work, of = (f"{what}: ", f" of the {what}") if what else ("", "")  # frames, for instance, have no name
    if size and folder is not None:
        free = shutil.disk_usage(_existing(folder)).free
        if size > free:
            raise InputError(
                f"{folder}: {counted(left, 'more part')}{of} {agreeing(left, 'take')} about "
                f"{readable_size(size)}, and its disk has {readable_size(free)} left; name an output on a larger one "
                "(-o), or split the work with --shard"
            )
    most = None if by else available_memory()
    if most is not None and unit.more > most:
        raise InputError(
            f"{work}a part takes about {readable_size(unit.more)} of memory, and {readable_size(most)} are left; run "
            "fewer processes on this machine, or study fewer observers and columns at once"
        )
    if (seconds := left * unit.seconds) >= _LONG:
        stored = f", {readable_size(size)} on disk" if size else ""
        needs = f"about {duration(seconds)}{by}, {readable_size(unit.memory)} of memory{stored}"
        _tell.get()(f"{work}{counted(left, 'more part', 'take')} {needs} (estimated from {unit.source})")


def _existing(folder: Path) -> Path:
    """The folder, or the first one around it that exists."""
    return next(each for each in (folder, *folder.absolute().parents) if each.exists())
