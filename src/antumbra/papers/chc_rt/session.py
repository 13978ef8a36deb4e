"""Measures the tables that are asked for. Each walkthrough is shown as soon as it has ended."""

import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from ...store.chunk_residency import POLICIES
from ..answers import agree
from . import ablation, measure, sizes, stores
from .kinds import WALKED, Table
from .measure import InCore, Pace, Say, Turn
from .rays import SAMPLER
from .stores import Digests
from .views import WalkPlace

Show = Callable[[list[Turn]], None]
Found = dict[Table, list]
"""Turns of each measured table, or `SceneSize`s. The turns of all WALKED tables are in `times`, or in `store`."""


def show_medians(turns: list[Turn]) -> None:
    """Print a line for each method and kind of rays to standard error, where the progress line makes room for it."""
    for row in measure.rows_of(turns, "scene", "view", "sampler", "kind", "method"):
        mine = measure.of(turns, **row)
        names = [value for value in row.values() if value != SAMPLER]
        text = f"{', '.join(names)}: {1e3 * measure.typical(mine):,.1f} ms a frame, of {len(mine)}"
        print(text, file=sys.stderr, flush=True)


def in_memory(
    places: Iterable[WalkPlace], tables: Sequence[Table], threads: int, pace: Pace, say: Say, show: Show,
    pictures: Path | None = None,
) -> tuple[Found, bool | None]:  # fmt: skip
    """(the turns of scenes in memory, whether all answers are the same); None: there are no answers.

    pictures : a folder for the figures, or None
    """
    found: Found = {}
    for place in places:
        say(f"{place.name}, building")
        core = InCore(place, threads)
        if pictures is not None:
            from .pictures import write_pictures

            write_pictures(core, pictures, say)
        if Table.scenes in tables:
            found.setdefault(Table.scenes, []).append(sizes.size_in_memory(core))
        walks: dict[Table, Iterable[list[Turn]]] = {
            Table.times: measure.times(core, pace, Table.times in tables, say),
            Table.randomisation: measure.randomisation(core, pace, say),
            Table.aggressive: measure.aggressive(core, pace, say),
            Table.ablation: ablation.in_memory(core, pace, say),
        }
        for name, each in walks.items():
            if name in tables or (name == Table.times and WALKED.intersection(tables)):
                found.setdefault(name, []).extend(_gathered(each, show))
    return found, differing(found) == 0 if found.keys() - {Table.scenes} else None


def out_of_core(
    place: WalkPlace, tables: Sequence[Table], memory: int | None, threads: int, pace: Pace, say: Say, show: Show
) -> tuple[Found, bool | None]:
    """(the turns of a store, whether all answers are the same); None: no answers are compared."""
    found: Found = {}
    digests: Digests = []
    if Table.scenes in tables:
        found[Table.scenes] = [sizes.size_of_store(place, memory)]
    if WALKED.intersection(tables):
        policies = POLICIES if Table.store in tables else POLICIES[:1]
        walks = stores.out_of_core(place, memory, threads, pace, policies, say)
        found[Table.store] = _gathered(_without(digests, walks), show)
    if Table.aggressive in tables:
        found[Table.aggressive] = _gathered(stores.aggressive(place, memory, threads, pace, say), show)
    if Table.ablation in tables:
        walks = ablation.out_of_core(place, memory, threads, pace, say)
        found[Table.ablation] = _gathered(_without(digests, walks), show)
    return found, agree(digests) if {Table.store, Table.ablation}.intersection(tables) else None


def differing(found: Found) -> int:
    """The number of rays for which an exact method has given another answer."""
    turns = (t for name, rows in found.items() if name != Table.scenes for t in rows)
    return sum(t.differs for t in turns if t.error is None)


def _gathered(walks: Iterable[list[Turn]], show: Show) -> list[Turn]:
    """All turns of walkthroughs, each shown when it has ended."""
    turns: list[Turn] = []
    for walk in walks:
        show(walk)
        turns += walk
    return turns


def _without(digests: Digests, walks: Iterable[tuple[list[Turn], Digests]]) -> Iterable[list[Turn]]:
    """The turns of walkthroughs, whose digests are added to `digests`."""
    for turns, new in walks:
        digests += new
        yield turns
