"""Measures and prints the tables of ``antumbra bench chc-rt``, beside the paper's.

Among them are the sizes of scenes [Mattausch et al. 2015, Table 1], and CHC+RT without its parts and with other
parameters (Sec. 4.4, 4.5, 5.1, 5.2, 6). Each walkthrough is shown as soon as it has ended.
"""

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from math import inf
from pathlib import Path
from typing import NamedTuple

from ...cli import console as report
from ...engine.paged_scene import PagedScene
from ...engine.paged_source import MAX_MEMORY
from ...errors import InputError
from ...store.chunk_residency import POLICIES
from ...store.store_format import chunk_places
from ...techniques.tracer_options import WHOLE_SCREEN
from ..benchmark_views import agree
from . import chcrt_published as paper
from . import walkthrough_timing as bench
from . import walkthrough_timing as measure
from . import walkthrough_timing as stores
from .chcrt_published import WALKED, ChcrtTable
from .walkthrough_timing import Digests, InCore, Pace, Say, Turn, hit_rate
from .walkthroughs import AO, DIFFUSE, PLANS, SAMPLER, SOFT, WalkPlace

# --- The sizes of scenes [Mattausch et al. 2015, Table 1] -------------------------------------------------------------


class SceneSize(NamedTuple):
    """The size of a scene in bytes: of what CHC+RT traces in memory, or of a store's file."""

    scene: str
    triangles: int
    total: int  # a store also has a directory, and zeros up to whole pages
    bvh: int  # the nodes
    geometry: int  # triangles and their colours
    share: float  # the memory that may be used, as a share of `total`, at most 1


def size_in_memory(core: InCore) -> SceneSize:
    """The size of a scene in memory."""
    bvh, geometry = core.bytes()
    return SceneSize(core.place.name, core.place.scene.n_triangles, bvh + geometry, bvh, geometry, 1.0)


def size_of_store(place: WalkPlace, max_memory: int | None) -> SceneSize:
    """The size of a store. All of `max_memory` counts for its share, though rays and pictures take some."""
    scene = place.scene
    if not isinstance(scene, PagedScene):
        raise InputError(f"{place.name}: is not a store; name it with --scene instead of --store")
    chunks, top = scene.store.chunks, scene.store.top
    bvh, geometry = top.nodes.nbytes, 0
    for triangles, nodes, colours in zip(*(a.tolist() for a in (chunks.triangles, chunks.nodes, chunks.colours))):
        at = chunk_places(triangles, nodes, colours)
        bvh, geometry = bvh + at.corners - at.nodes, geometry + at.end - at.corners
    total, most = scene.store.path.stat().st_size, max_memory or scene.max_memory or MAX_MEMORY
    return SceneSize(place.name, scene.n_triangles, total, bvh, geometry, min(most / total, 1.0))


# ---------------------------------------------------------------------------------------------------------------------
# Measures CHC+RT without its parts, and with other parameters [Mattausch et al. 2015, Sec. 4.4, 4.5, 5.1, 5.2, 6].


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


def ablate_in_memory(core: InCore, pace: Pace, say: Say) -> Iterator[list[Turn]]:
    """The near walkthrough by all variants, which take turns in each frame."""
    methods = [core.culling_by(name, changed) for name, changed in VARIANTS.items()]
    pace = pace._replace(most=_MOST)
    yield measure.walk_through(core, core.place.walks[0], methods, (AO, DIFFUSE, SOFT), SAMPLER, pace, say)


def ablate_out_of_core(
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
            turns, digests = stores.walk_through_store(place, place.walks[0], paged, name, pace, say)
        pace = pace._replace(most=1 + turns[-1].frame, limit=inf)
        yield turns, digests


# --- Measures the tables that are asked for. Each walkthrough is shown as soon as it has ended ------------------------


Show = Callable[[list[Turn]], None]
TableRows = dict[ChcrtTable, list]
"""Turns of each measured table, or `SceneSize`s. The turns of all WALKED tables are in `times`, or in `store`."""


def show_medians(turns: list[Turn]) -> None:
    """Print a line for each method and kind of rays to standard error, where the progress line makes room for it."""
    for row in measure.rows_of(turns, "scene", "view", "sampler", "kind", "method"):
        mine = measure.of(turns, **row)
        names = [value for value in row.values() if value != SAMPLER]
        text = f"{', '.join(names)}: {1e3 * measure.typical(mine):,.1f} ms a frame, of {len(mine)}"
        print(text, file=sys.stderr, flush=True)


def measure_in_memory(
    places: Iterable[WalkPlace], tables: Sequence[ChcrtTable], threads: int, pace: Pace, say: Say, show: Show,
    pictures: Path | None = None,
) -> tuple[TableRows, bool | None]:  # fmt: skip
    """(the turns of scenes in memory, whether all answers are the same); None: there are no answers.

    pictures : a folder for the figures, or None
    """
    found: TableRows = {}
    for place in places:
        say(f"{place.name}, building")
        core = InCore(place, threads)
        if pictures is not None:
            from .chcrt_figures import write_pictures

            write_pictures(core, pictures, say)
        if ChcrtTable.scenes in tables:
            found.setdefault(ChcrtTable.scenes, []).append(size_in_memory(core))
        walks: dict[ChcrtTable, Iterable[list[Turn]]] = {
            ChcrtTable.times: measure.times(core, pace, ChcrtTable.times in tables, say),
            ChcrtTable.randomisation: measure.randomisation(core, pace, say),
            ChcrtTable.aggressive: measure.aggressive(core, pace, say),
            ChcrtTable.ablation: ablate_in_memory(core, pace, say),
        }
        for name, each in walks.items():
            if name in tables or (name == ChcrtTable.times and WALKED.intersection(tables)):
                found.setdefault(name, []).extend(_gathered(each, show))
    return found, differing(found) == 0 if found.keys() - {ChcrtTable.scenes} else None


def measure_out_of_core(
    place: WalkPlace, tables: Sequence[ChcrtTable], memory: int | None, threads: int, pace: Pace, say: Say, show: Show
) -> tuple[TableRows, bool | None]:
    """(the turns of a store, whether all answers are the same); None: no answers are compared."""
    found: TableRows = {}
    digests: Digests = []
    if ChcrtTable.scenes in tables:
        found[ChcrtTable.scenes] = [size_of_store(place, memory)]
    if WALKED.intersection(tables):
        policies = POLICIES if ChcrtTable.store in tables else POLICIES[:1]
        walks = stores.out_of_core(place, memory, threads, pace, policies, say)
        found[ChcrtTable.store] = _gathered(_without(digests, walks), show)
    if ChcrtTable.aggressive in tables:
        found[ChcrtTable.aggressive] = _gathered(stores.aggressive_out_of_core(place, memory, threads, pace, say), show)
    if ChcrtTable.ablation in tables:
        walks = ablate_out_of_core(place, memory, threads, pace, say)
        found[ChcrtTable.ablation] = _gathered(_without(digests, walks), show)
    return found, agree(digests) if {ChcrtTable.store, ChcrtTable.ablation}.intersection(tables) else None


def differing(found: TableRows) -> int:
    """The number of rays for which an exact method has given another answer."""
    turns = (t for name, rows in found.items() if name != ChcrtTable.scenes for t in rows)
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


# --- Prints the tables of ``antumbra bench chc-rt``, beside the paper's -----------------------------------------------


_WIDTH = 170  # width of the tables, in characters
_ROW = ("scene", "view", "kind")


def _ms(seconds: float | None) -> str:
    return "" if seconds is None else f"{1e3 * seconds:,.1f}"


def _cells(row: dict) -> tuple[str, ...]:
    return tuple(row.values())


def _paper(scene: str, *cells: str) -> tuple[str, ...]:
    return (f"(paper: {scene})", *cells)


def _is_paged(turns: list[Turn]) -> bool:
    return any("bytes" in t.told for t in turns)


def _print_scenes(sizes: list[SceneSize]) -> None:
    """Print Table 1."""
    table = []
    for s in sizes:
        megabytes = (f"{n / 1e6:,.1f}" for n in (s.total, s.bvh, s.geometry))
        table.append((s.scene, f"{s.triangles:,}", *megabytes, f"{100 * s.share:.0f}"))
    for name, (triangles, total, bvh, geometry, share) in paper.MODELS.items():
        table.append(_paper(name, f"{triangles:,.0f}", f"{total:,}", f"{bvh:,}", f"{geometry:,}", f"{share}"))
    print("Sizes of what CHC+RT traces, in memory or in the file of a store, and the memory it may use (Table 1)")
    head = "scene", "triangles", "MB", "MB of the BVH", "MB of geometry", "memory, % of MB"
    report.print_table(head, table, right=range(1, len(head)), width=_WIDTH)


def _print_times(turns: list[Turn]) -> None:
    """Print Table 2."""
    (_print_paged_times if _is_paged(turns) else _print_times_in_core)(turns)


def _print_paged_times(turns: list[Turn]) -> None:
    table = []
    for row, mine in _told(turns):
        table.append((*row, f"{mine[-1].rays:,}", _ms(bench.first(mine)), _ms(bench.typical(mine)), f"{len(mine)}"))
    for name, times in paper.PAGED_TIMES.items():
        for v, view in enumerate(("near", "far")):
            for kind, ms in zip(paper.KINDS, times[v]):
                table.append(_paper(name, view, kind, "", "", "", f"{ms:,}", ""))
    head = (*_ROW, "makes room by", "rays", "first frame", "chcrt", "frames")
    print("Milliseconds a frame out of core (Table 2)")
    report.print_table(head, table, right=range(4, len(head)), width=_WIDTH)


def _print_times_in_core(turns: list[Turn]) -> None:
    table, best = [], 0.0
    for row in bench.rows_of(turns, *_ROW):
        ours = bench.of(turns, **row, method=bench.CHCRT)
        cells = [f"{ours[-1].rays:,}", _ms(bench.first(ours)), _ms(bench.typical(ours))]
        for plan in PLANS:
            theirs = bench.of(turns, **row, method=plan)
            ratio = bench.speedup(ours, theirs) if theirs else 0.0
            best = max(best, ratio)
            cells += [_ms(bench.typical(theirs)), f"{ratio:.2f}"] if theirs else ["", ""]
        differs = sum(t.differs for t in bench.of(turns, **row))
        table.append((*_cells(row), *cells, f"{len(ours)}", f"{differs}"))
    for name, methods in paper.TIMES.items():
        for v, view in enumerate(("near", "far")):
            for k, kind in enumerate(paper.KINDS):
                glsl, chc, cuda = (methods[m][v][k] for m in ("GLSL", "CHC+RT", "CUDA"))
                figures = f"{glsl:,}", f"{glsl / chc:.2f}", f"{cuda:,}", f"{cuda / chc:.2f}"
                table.append(_paper(name, view, kind, "", "", f"{chc:,}", *figures, "", "", "", ""))
    plans = [cell for plan in PLANS for cell in (plan, "ratio")]
    head = (*_ROW, "rays", "first frame", "chcrt", *plans, "frames", "differ")
    print("Milliseconds a frame, and how many times as long as chcrt others take in the same frames (Table 2)")
    report.print_table(head, table, right=range(3, len(head)), width=_WIDTH)
    print("(paper: the first of the others is GLSL, from the root; the second is CUDA)")
    report.print_fields([("fastest", f"{best:.2f} times plain tracing (the paper's {paper.BEST})")])
    print()


def _told(turns: list[Turn]) -> Iterator[tuple[tuple[str, ...], list[Turn]]]:
    """(first cells of a row, its turns) for all turns that have statistics of CHC+RT."""
    for row in bench.rows_of([t for t in turns if t.told], *_ROW, "method"):
        yield _cells(row), bench.of(turns, **row)


def _print_phases(turns: list[Turn]) -> None:
    """Print Fig. 8 as a table."""
    table = []
    for row, mine in _told(turns):
        parts = [bench.typical(mine, phase) for phase in bench.PHASES]
        rest = bench.typical(mine, "before")
        table.append((*row, *map(_ms, (*parts, rest)), _ms(bench.typical(mine))))
    head = (*_ROW, "method", *bench.PHASES, "before", "all")
    print("Milliseconds a frame by phase: what was visible, queries about it, what has become visible (Figure 8)")
    report.print_table(head, table, right=range(4, len(head)), width=_WIDTH)


def _print_queries(turns: list[Turn]) -> None:
    """Print Table 3."""
    names = "queries", "multi_queries", "traced pairs", "visible", "invisible"
    table = []
    for row, mine in _told(turns):
        counts = [f"{bench.typical(mine, name):,.0f}" for name in names]
        rate = mine[-1].rays / bench.typical(mine) / 1e6
        moved = (bench.typical(mine, name) / 1e6 for name in ("bytes", "bvh_bytes", "geometry_bytes"))
        table.append((*row, f"{rate:.2f}", *counts, *(f"{mb:,.2f}" for mb in moved)))
    for name, (rates, queries, megabytes) in paper.STATISTICS.items():
        split = megabytes, *paper.MOVED[name]
        for v, view in enumerate(("near", "far")):
            for k, kind in enumerate(paper.KINDS):
                cells = f"{rates[v][k]:.2f}", f"{queries[v][k]:,.0f}", *[""] * 4, *(f"{mb[v][k]:,.2f}" for mb in split)
                table.append(_paper(name, view, kind, "", *cells))
    head = (
        *_ROW, "method", "M rays/s", "queries", "multi-queries", "traced pairs", "visible", "invisible", "MB moved",
        "BVH", "geometry",
    )  # fmt: skip
    print("A frame: rays, queries, pairs, and what was read of a store (Table 3)")
    report.print_table(head, table, right=range(4, len(head)), width=_WIDTH)


def _print_randomisation(turns: list[Turn]) -> None:
    """Print Table 5."""
    table = []
    for row in bench.rows_of(turns, *_ROW):
        mine = [bench.typical(bench.of(turns, **row, sampler=s)) for s in bench.SAMPLERS]
        table.append((row["scene"], row["kind"], *map(_ms, mine), f"{mine[-1] / mine[0]:.2f}"))
    for (name, kind), ms in paper.RANDOMISATION.items():
        table.append(_paper(name, kind, *(f"{m:,}" for m in ms), f"{ms[-1] / ms[0]:.2f}"))
    print("Milliseconds a frame, near, by how directions are rotated from pixel to pixel (Table 5)")
    head = ("scene", "kind", "none", "18 degrees", "36 degrees", "full", "full / none")
    report.print_table(head, table, right=range(2, len(head)), width=_WIDTH)


def _print_aggressive(turns: list[Turn]) -> None:
    """Print Table 4."""
    table = []
    for row in bench.rows_of(turns, "scene", "view", "method"):
        mine, exact = bench.of(turns, **row), bench.of(turns, **{**row, "method": bench.CHCRT})
        error = sum(t.error or 0.0 for t in mine) / len(mine)
        ratio = bench.typical(exact) / bench.typical(mine)
        if "bytes" in mine[0].told:
            missed, moved = "", f"{bench.typical(mine, 'bytes') / 1e6:,.1f}"
        else:
            missed = f"{100 * sum(t.differs for t in mine) / max(sum(t.rays for t in mine), 1):.3f}"
            moved = ""
        table.append((*_cells(row), _ms(bench.typical(mine)), f"{ratio:.2f}", missed, f"{error:.3f}", moved))
    for name, thresholds in paper.AGGRESSIVE.items():
        for v, view in enumerate(("near", "far")):
            for threshold, ms in thresholds.items():
                ratio = thresholds[0][v] / ms[v]
                table.append(_paper(name, view, f"{threshold} pixels", f"{ms[v]:,}", f"{ratio:.2f}", "", "", ""))
    print("Diffuse rays where a few rays of each tile are neglected (Table 4); error: mean, of 0 to 255")
    head = ("scene", "view", "method", "ms", "times as fast", "% rays that differ", "error", "MB read")
    report.print_table(head, table, right=range(3, len(head)), width=_WIDTH)
    report.print_fields([("the paper's error", f"{paper.ERROR} with 20 pixels")])
    print()


def _print_ablation(turns: list[Turn]) -> None:
    """Print what the parts of CHC+RT are worth."""
    table, paged = [], _is_paged(turns)
    for row, mine in _told(turns):
        base = bench.of(turns, **dict(zip(_ROW, row)), method=AS_IT_IS)
        ratio = bench.typical(mine) / bench.typical(base)
        counts = [f"{bench.typical(mine, name):,.0f}" for name in ("queries", "traced pairs", "visible")]
        read = [f"{sum(t.told['bytes'] for t in mine) / 1e6:,.1f}"] if paged else []
        table.append(
            (*row, _ms(bench.first(mine)), _ms(bench.typical(mine)), f"{ratio:.2f}", *counts, *read, f"{len(mine)}")
        )
    read = ["MB read in all"] if paged else []
    head = (*_ROW, "CHC+RT", "ms first", "ms", "ratio", "queries", "traced pairs", "visible pairs", *read, "frames")
    print("CHC+RT without its parts and with other parameters: a frame, and how many times as long it takes")
    report.print_table(head, table, right=range(4, len(head)), width=_WIDTH)
    told = f"Powerplant takes {paper.SCREEN_HIERARCHY} times as long without the screen hierarchy (Section 6)"
    report.print_fields([("in the paper", told)])
    print()


def _print_store(turns: list[Turn]) -> None:
    """Print the chunks and bytes that both eviction policies read."""
    table = []
    for row, mine in _told(turns):
        begun, after = mine[0].told, bench.later(mine)
        wanted, loaded, moved = (sum(t.told[n] for t in after) / len(after) for n in ("wanted", "loaded", "bytes"))
        cells = f"{begun['loaded']:,}", f"{begun['bytes'] / 1e6:,.1f}", _ms(bench.first(mine)), _ms(bench.typical(mine))
        share = f"{100 * hit_rate(after):.2f}"
        table.append((*row, *cells, f"{wanted:,.1f}", share, f"{loaded:,.1f}", f"{moved / 1e6:,.2f}"))
    head = (
        *_ROW, "makes room by", "chunks first", "MB first", "ms first", "ms", "chunks wanted", "% in memory",
        "chunks read", "MB read",
    )  # fmt: skip
    print("A store: the first frame, and the mean of those after it (ms: median)")
    report.print_table(head, table, right=range(4, len(head)), width=_WIDTH)


PRINT: dict[ChcrtTable, Callable[[list], None]] = {
    ChcrtTable.scenes: _print_scenes,
    ChcrtTable.times: _print_times,
    ChcrtTable.phases: _print_phases,
    ChcrtTable.queries: _print_queries,
    ChcrtTable.randomisation: _print_randomisation,
    ChcrtTable.aggressive: _print_aggressive,
    ChcrtTable.ablation: _print_ablation,
    ChcrtTable.store: _print_store,
}
