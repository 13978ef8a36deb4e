"""Prints the tables of ``antumbra bench chc-rt``, beside the paper's."""

from collections.abc import Callable, Iterator

from ...cli import console as report
from . import measure as bench
from . import published as paper
from .ablation import AS_IT_IS
from .kinds import Table
from .measure import Turn
from .rays import PLANS
from .sizes import SceneSize
from .stores import hit_rate

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


PRINT: dict[Table, Callable[[list], None]] = {
    Table.scenes: _print_scenes,
    Table.times: _print_times,
    Table.phases: _print_phases,
    Table.queries: _print_queries,
    Table.randomisation: _print_randomisation,
    Table.aggressive: _print_aggressive,
    Table.ablation: _print_ablation,
    Table.store: _print_store,
}
