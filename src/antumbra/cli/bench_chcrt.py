"""``antumbra bench chc-rt``: what occlusion culling for rays costs and saves, in memory and out of core."""

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..errors import InputError
from . import arguments, report
from .activity import Activity
from .opening import open_view
from .options import Json, Quiet, Threads

if TYPE_CHECKING:
    from ..bench.chcrt import Turn

_WIDTH = 170  # of the tables, in characters
_ROW = ("scene", "view", "kind")


class Table(StrEnum):
    times = "times"
    phases = "phases"
    queries = "queries"
    randomisation = "randomisation"
    aggressive = "aggressive"
    store = "store"


_PAGED = Table.store, Table.phases, Table.queries
_WALKED = {Table.times, Table.phases, Table.queries, Table.store}
_IN_CORE = tuple(table for table in Table if table != Table.store)


def chc_rt(
    scene: Annotated[
        list[str] | None,
        typer.Option(
            help="A folder of $ANTUMBRA_SCENES, a file, a procedural scene; may be repeated.  [default: the city, and "
            "sanmiguel_lite where it is there]",
            metavar="SCENE",
            show_default=False,
        ),
    ] = None,
    store: Annotated[
        Path | None,
        typer.Option(
            help="Instead of scenes in memory, a store that antumbra build has made.",
            metavar="FILE",
            show_default=False,
        ),
    ] = None,
    max_memory: Annotated[
        str | None,
        typer.Option(
            help="Memory for the store, in bytes, or with M or G: 512M.  [default: 4G]",
            metavar="SIZE",
            show_default=False,
        ),
    ] = None,
    table: Annotated[
        list[Table] | None,
        typer.Option(help="Measure only this; may be repeated.  [default: all]", show_default=False),
    ] = None,
    plot: Annotated[
        Path | None, typer.Option(help="Write bars and curves to a .png file.", metavar="FILE", show_default=False)
    ] = None,
    triangles: Annotated[str, typer.Option(help="Size of the city.", metavar="N")] = "10M",
    size: Annotated[str, typer.Option(help="Size of the pictures.", metavar="WxH")] = "640x360",
    frames: Annotated[int, typer.Option(help="Frames of a walkthrough.", min=1, max=10_000)] = 60,
    compared: Annotated[
        int, typer.Option(help="In how many frames the other plans have their turns.", min=1, max=10_000)
    ] = 3,
    limit: Annotated[
        float,
        typer.Option(help="End a walkthrough after so long; two frames come anyway.", metavar="SECONDS", min=0.0),
    ] = 120.0,
    threads: Threads = None,
    json: Json = False,
    quiet: Quiet = False,
) -> None:
    """CHC+RT beside tracing from the root: times, phases, queries, what is paged [Mattausch et al. 2015].

    Near and far walkthroughs, whose state is kept from frame to frame: primary rays, 20 rays of ambient occlusion and
    20 diffuse rays for each pixel, 16 shadow rays to a light with an area. Times are medians over the frames after the
    first (Table 2), by phase (Figure 8), with queries and bytes moved (Table 3), by randomisation of directions (Table
    5) and in aggressive mode (Table 4); of a store also its hits and its two ways to make room.

    \b
    Examples
      antumbra bench chc-rt --triangles 1M --frames 20
      antumbra bench chc-rt --scene sanmiguel_lite --table times --table phases --plot chcrt.png
      antumbra bench chc-rt --store city.antumbra --max-memory 1G
    """
    width_height = arguments.parse_size(size)
    tables = _checked_tables(table, scene, store, max_memory)
    memory = None if max_memory is None else arguments.parse_bytes(max_memory, "--max-memory")
    count = arguments.parse_count(triangles, "--triangles")

    from ..bench import chcrt as bench
    from ..bench import chcrt_store, chcrt_views
    from ..bench.answers import agree
    from ..parallel import thread_count
    from ..resident import peak_resident
    from ..scene.procedural.request import checked

    checked("city", count, 0)
    if plot is not None:
        if not _WALKED & {*tables}:
            raise InputError("--plot shows what --table times, phases, queries or store measure; name one of them")
        arguments.check_plot(plot)
    n_threads, pace = thread_count(threads), bench.Pace(frames, compared, limit)
    found: dict[Table, list[Turn]] = {}
    same = True
    with Activity(quiet) as activity:
        activity.say("opening the scenes")
        names = dict.fromkeys([str(store)] if store else scene or chcrt_views.default_names(count))
        views = [open_view(name, width_height, chcrt_views.named_view) for name in names]
        if store is None:
            for view in views:
                chcrt_views.check_in_memory(view)
        for place in map(chcrt_views.place_of, views):
            if store is not None:
                found[Table.store], digests = chcrt_store.out_of_core(place, memory, n_threads, pace, activity.say)
                same = agree(digests)
                break
            activity.say(f"{place.name}, building")
            core = bench.InCore(place, n_threads)
            if _WALKED & {*tables}:
                new = bench.times(core, pace, Table.times in tables, activity.say)
                found.setdefault(Table.times, []).extend(new)
            if Table.randomisation in tables:
                found.setdefault(Table.randomisation, []).extend(bench.randomisation(core, pace, activity.say))
            if Table.aggressive in tables:
                found.setdefault(Table.aggressive, []).extend(bench.aggressive(core, pace, activity.say))
        if plot is not None:
            from ..bench.chcrt_plot import write_plot

            write_plot(found.get(Table.store) or found.get(Table.times) or [], plot)
    differs = sum(t.differs for turns in found.values() for t in turns if t.error is None)
    same, peak = same and not differs, peak_resident()
    if json:
        asked = {"size": width_height, "frames": frames, "compared": compared, "limit": limit, "threads": n_threads}
        rows = {name.value: [t._asdict() for t in turns] for name, turns in found.items()}
        report.print_json({**asked, **rows, "differs": differs, "same_answers": same, "peak_resident": peak})
        return
    if quiet:
        return
    walked = found.get(Table.store) or found.get(Table.times) or []
    for name in tables:
        _PRINT[name](found.get(name, walked))
    told = "the same by all methods" if same else f"DIFFER, of {differs:,} rays: please report this"
    report.print_fields([("answers", told), ("memory at its peak", report.size_in_memory(peak) if peak else "unknown")])


def _checked_tables(tables, scene, store, max_memory) -> tuple[Table, ...]:
    """The tables that are wanted, in their order; InputError on options that do not go together."""
    if store is None and max_memory is not None:
        raise InputError("--max-memory is for --store; leave it out")
    if store is not None and scene:
        raise InputError("--store is measured by itself; leave --scene out")
    possible = _IN_CORE if store is None else _PAGED
    wrong = [name.value for name in tables or () if name not in possible]
    if wrong:
        cure = "name a --store" if store is None else "leave --store out"
        raise InputError(f"--table {wrong[0]} has nothing to measure; {cure}")
    return tuple(name for name in possible if not tables or name in tables)


def _ms(seconds: float | None) -> str:
    return "" if seconds is None else f"{1e3 * seconds:,.1f}"


def _cells(row: dict) -> tuple[str, ...]:
    return tuple(row.values())


def _paper(scene: str, *cells: str) -> tuple[str, ...]:
    return (f"(paper: {scene})", *cells)


def _print_times(turns: "list[Turn]") -> None:
    """Table 2."""
    from ..bench import chcrt as bench
    from ..bench import published_chcrt as paper
    from ..bench.chcrt_rays import PLANS

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


def _print_phases(turns: "list[Turn]") -> None:
    """Fig. 8 as a table."""
    from ..bench import chcrt as bench

    table = []
    for row in _chcrt_rows(turns):
        mine = bench.of(turns, **row)
        parts = [bench.typical(mine, phase) for phase in bench.PHASES]
        rest = bench.typical(mine, "before")
        table.append((*_cells(row), *map(_ms, (*parts, rest)), _ms(bench.typical(mine))))
    head = (*_ROW, "method", *bench.PHASES, "before", "all")
    print("Milliseconds a frame by phase: what was visible, queries about it, what has become visible (Figure 8)")
    report.print_table(head, table, right=range(4, len(head)), width=_WIDTH)


def _chcrt_rows(turns: "list[Turn]") -> list[dict]:
    from ..bench import chcrt as bench

    return bench.rows_of([t for t in turns if t.told], *_ROW, "method")


def _print_queries(turns: "list[Turn]") -> None:
    """Table 3."""
    from ..bench import chcrt as bench
    from ..bench import published_chcrt as paper

    names = "queries", "multi_queries", "traced pairs", "visible", "invisible"
    table = []
    for row in _chcrt_rows(turns):
        mine = bench.of(turns, **row)
        counts = [f"{bench.typical(mine, name):,.0f}" for name in names]
        rate = mine[-1].rays / bench.typical(mine) / 1e6
        table.append((*_cells(row), f"{rate:.2f}", *counts, f"{bench.typical(mine, 'bytes') / 1e6:,.2f}"))
    for name, (rates, queries, moved) in paper.STATISTICS.items():
        for v, view in enumerate(("near", "far")):
            for k, kind in enumerate(paper.KINDS):
                cells = f"{rates[v][k]:.2f}", f"{queries[v][k]:,.0f}", *[""] * 4, f"{moved[v][k]:,.2f}"
                table.append(_paper(name, view, kind, "", *cells))
    head = (*_ROW, "method", "M rays/s", "queries", "multi-queries", "traced pairs", "visible", "invisible", "MB moved")
    print("A frame: rays, queries, pairs, and what was read of a store (Table 3)")
    report.print_table(head, table, right=range(4, len(head)), width=_WIDTH)


def _print_randomisation(turns: "list[Turn]") -> None:
    """Table 5."""
    from ..bench import chcrt as bench
    from ..bench import published_chcrt as paper

    table = []
    for row in bench.rows_of(turns, *_ROW):
        mine = [bench.typical(bench.of(turns, **row, sampler=s)) for s in bench.SAMPLERS]
        table.append((row["scene"], row["kind"], *map(_ms, mine), f"{mine[-1] / mine[0]:.2f}"))
    for (name, kind), ms in paper.RANDOMISATION.items():
        table.append(_paper(name, kind, *(f"{m:,}" for m in ms), f"{ms[-1] / ms[0]:.2f}"))
    print("Milliseconds a frame, near, by how directions are rotated from pixel to pixel (Table 5)")
    head = ("scene", "kind", "none", "18 degrees", "36 degrees", "full", "full / none")
    report.print_table(head, table, right=range(2, len(head)), width=_WIDTH)


def _print_aggressive(turns: "list[Turn]") -> None:
    """Table 4."""
    from ..bench import chcrt as bench
    from ..bench import published_chcrt as paper

    table = []
    for row in bench.rows_of(turns, "scene", "view", "method"):
        mine, exact = bench.of(turns, **row), bench.of(turns, **{**row, "method": bench.CHCRT})
        error = sum(t.error or 0.0 for t in mine) / len(mine)
        missed = sum(t.differs for t in mine) / max(sum(t.rays for t in mine), 1)
        ratio = bench.typical(exact) / bench.typical(mine)
        cells = _ms(bench.typical(mine)), f"{ratio:.2f}", f"{100 * missed:.3f}", f"{error:.3f}"
        table.append((*_cells(row), *cells))
    for name, thresholds in paper.AGGRESSIVE.items():
        for v, view in enumerate(("near", "far")):
            for threshold, ms in thresholds.items():
                ratio = thresholds[0][v] / ms[v]
                table.append(_paper(name, view, f"{threshold} pixels", f"{ms[v]:,}", f"{ratio:.2f}", "", ""))
    print("Diffuse rays where a few rays of each tile are neglected (Table 4); error: mean, of 0 to 255")
    head = ("scene", "view", "method", "ms", "times as fast", "% rays that differ", "error")
    report.print_table(head, table, right=range(3, len(head)), width=_WIDTH)
    report.print_fields([("the paper's error", f"{paper.ERROR} with 20 pixels")])
    print()


def _print_store(turns: "list[Turn]") -> None:
    """What is read, by both policies."""
    from ..bench import chcrt as bench
    from ..bench.chcrt_store import hit_rate

    table = []
    for row in _chcrt_rows(turns):
        mine = bench.of(turns, **row)
        begun, after = mine[0].told, bench.later(mine)
        wanted, loaded, moved = (sum(t.told[n] for t in after) / len(after) for n in ("wanted", "loaded", "bytes"))
        cells = f"{begun['loaded']:,}", f"{begun['bytes'] / 1e6:,.1f}", _ms(bench.first(mine)), _ms(bench.typical(mine))
        share = f"{100 * hit_rate(after):.2f}"
        table.append((*_cells(row), *cells, f"{wanted:,.1f}", share, f"{loaded:,.1f}", f"{moved / 1e6:,.2f}"))
    head = (
        *_ROW, "makes room by", "chunks first", "MB first", "ms first", "ms", "chunks wanted", "% in memory",
        "chunks read", "MB read",
    )  # fmt: skip
    print("A store: the first frame, and the mean of those after it (ms: median)")
    report.print_table(head, table, right=range(4, len(head)), width=_WIDTH)


_PRINT = {
    Table.times: _print_times,
    Table.phases: _print_phases,
    Table.queries: _print_queries,
    Table.randomisation: _print_randomisation,
    Table.aggressive: _print_aggressive,
    Table.store: _print_store,
}
