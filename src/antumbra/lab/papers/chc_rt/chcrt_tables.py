"""Prints the tables of ``antumbra bench chc-rt``, with the paper's results [Mattausch et al. 2015]."""

from collections.abc import Callable, Iterable
from functools import partial
from statistics import fmean, median
from typing import Any

from ....store.chunk_residency import POLICIES
from ..bench_runner import TableColumn, columns_of, item, label, ms, print_notes, print_table
from . import chcrt_published, mapped_tree, store_walkthroughs, walkthrough_timing
from .chcrt_measurements import BASELINE, SceneSize, TableRows
from .chcrt_published import ChcrtTable
from .store_walkthroughs import hit_rate
from .walkthrough_timing import Turn
from .walkthroughs import BUILD, FRUSTA, SINGLE, TRACERS

# --- Columns ----------------------------------------------------------------------------------------------------------


_ROW = ("scene", "view", "kind")
Group = tuple[dict[str, str], list[Turn]]
"""A row of a table: the values that its turns have in common, and the turns."""


def _named(head: str, published: int | None = None, name: str = "") -> TableColumn:
    """A column of text: a common value of a `Group`, and item `published` of a published row."""
    return label(head, item(0, lambda common: common[name or head]), None if published is None else item(published))


def _by_turns(
    head: str, cell: Callable[[list[Turn]], str], published: Callable[[Any], str] | None = None
) -> TableColumn:
    """A column of numbers from the turns of a `Group`."""
    return TableColumn(head, item(1, cell), published)


def _typical(head: str, value: str = "seconds", published: Callable[[Any], str] | None = None) -> TableColumn:
    """A column of a value's median, in milliseconds."""
    return _by_turns(head, lambda turns: ms(walkthrough_timing.typical(turns, value)), published)


def _count(group: Group, name: str) -> str:
    """The median of a statistic."""
    return f"{walkthrough_timing.typical(group[1], name):,.0f}"


_FIRST = _by_turns("first frame", lambda turns: ms(walkthrough_timing.first(turns)))
_FRAMES = _by_turns("frames", lambda turns: f"{len(turns)}")
_PUBLISHED_ROW = (_named("scene", 0), _named("view", 1), _named("kind", 2))


def _groups(turns: list[Turn], *fields: str) -> list[Group]:
    """The turns by the values of these fields."""
    return [(row, walkthrough_timing.of(turns, **row)) for row in walkthrough_timing.rows_of(turns, *fields)]


def _with_statistics(turns: list[Turn]) -> list[Group]:
    """The turns with CHC+RT statistics, by scene, view, ray kind and method."""
    return _groups([t for t in turns if t.statistics], *_ROW, "method")


def _published(figures: Iterable[tuple[str, Callable[[int, int], tuple[Any, ...]]]]) -> list[tuple[Any, ...]]:
    """Published rows (scene, view, kind, *figures of view v and kind k) of (scene, function of v and k)."""
    return [
        (f"(paper: {name})", view, kind, *of(v, k))
        for name, of in figures
        for v, view in enumerate(("near", "far"))
        for k, kind in enumerate(chcrt_published.KINDS)
    ]


def _is_paged(turns: list[Turn]) -> bool:
    return any("bytes" in t.statistics for t in turns)


def _print_scenes(sizes: list[SceneSize]) -> None:
    """Print Table 1."""
    megabytes = lambda name: lambda s: f"{getattr(s, name) / 1e6:,.1f}"
    figure = lambda k: lambda row: f"{row[1][k]:,.0f}"
    columns = (
        label("scene", "scene", lambda row: f"(paper: {row[0]})"),
        TableColumn("triangles", lambda s: f"{s.triangles:,}", figure(0)),
        TableColumn("MB", megabytes("total"), figure(1)),
        TableColumn("BVH, MB", megabytes("bvh"), figure(2)),
        TableColumn("geometry, MB", megabytes("geometry"), figure(3)),
        TableColumn("memory limit, %", lambda s: f"{100 * s.share:.0f}", figure(4)),
    )
    title = "Scene sizes, in memory or in a store's file, and the memory limit (Table 1)"
    print_table(title, columns, sizes, chcrt_published.MODELS.items())


def _print_paged_times(turns: list[Turn]) -> None:
    """Print Table 2 out of core."""
    columns = (
        *_PUBLISHED_ROW,
        _named("eviction", name="method"),
        _by_turns("rays", lambda mine: f"{mine[-1].rays:,}"),
        _FIRST,
        _typical("chcrt", published=item(3)),
        _FRAMES,
    )
    published = (
        (name, lambda v, k, ms=times: (f"{ms[v][k]:,}",)) for name, times in chcrt_published.PAGED_TIMES.items()
    )
    title = "Milliseconds per frame, out of core (Table 2)"
    print_table(title, columns, _with_statistics(turns), _published(published))


def _print_times(turns: list[Turn]) -> None:
    """Print Table 2 in memory."""
    by = {
        (name, *row.values()): mine
        for name in (walkthrough_timing.CHCRT, *TRACERS)
        for row, mine in _groups(walkthrough_timing.of(turns, method=name), *_ROW)
    }
    ours = lambda group: by[walkthrough_timing.CHCRT, *group[0].values()]
    theirs = lambda group, name: by.get((name, *group[0].values()))

    def tracer_columns(k: int, name: str) -> tuple[TableColumn, TableColumn]:
        time, ratio = (item(4 + 2 * k), item(5 + 2 * k)) if k < 2 else (None, None)
        speedup = lambda group, other: f"{walkthrough_timing.speedup(ours(group), other):.2f}"
        return (
            TableColumn(
                name,
                lambda group: ms(walkthrough_timing.typical(other)) if (other := theirs(group, name)) else "",
                time,
            ),
            TableColumn("ratio", lambda group: speedup(group, other) if (other := theirs(group, name)) else "", ratio),
        )

    columns = (
        *_PUBLISHED_ROW,
        TableColumn("rays", lambda group: f"{ours(group)[-1].rays:,}"),
        TableColumn("first frame", lambda group: ms(walkthrough_timing.first(ours(group)))),
        TableColumn("chcrt", lambda group: ms(walkthrough_timing.typical(ours(group))), item(3)),
        *(column for k, name in enumerate(TRACERS) for column in tracer_columns(k, name)),
        TableColumn("frames", lambda group: f"{len(ours(group))}"),
        _by_turns("differ", lambda mine: f"{sum(t.differs for t in mine)}"),
    )

    def figures(methods: Any, v: int, k: int) -> tuple[str, ...]:
        glsl, chc, cuda = (methods[m][v][k] for m in ("GLSL", "CHC+RT", "CUDA"))
        return f"{chc:,}", f"{glsl:,}", f"{glsl / chc:.2f}", f"{cuda:,}", f"{cuda / chc:.2f}"

    published = _published((name, partial(figures, methods)) for name, methods in chcrt_published.TIMES.items())
    title = f"Milliseconds per frame in one tree ({BUILD}), and their ratio to chcrt in the same frames (Table 2)"
    print_table(title, columns, _groups(turns, *_ROW), published)
    print("(paper: the first of the other tracers is GLSL, from the root; the second is CUDA)")
    print()


def _print_speedups(turns: list[Turn]) -> None:
    """Print the speedups over tracing from the root, kind by kind, beside the paper's for the same kind."""
    spread = lambda ratios: f"{min(ratios):.2f} to {max(ratios):.2f}" if ratios else ""
    middle = lambda ratios: f"{median(ratios):.2f}" if ratios else ""
    columns = (
        label("kind", item(0)),
        *(
            column
            for k, name in enumerate((f"over {SINGLE}", f"over {FRUSTA}", "the paper's"), 1)
            for column in (TableColumn(name, item(k, middle)), TableColumn("scenes and views", item(k, spread)))
        ),
    )
    frusta = walkthrough_timing.speedups(turns, FRUSTA)
    rows = [
        (kind, ours, frusta.get(kind, []), published_speedups(kind))
        for kind, ours in walkthrough_timing.speedups(turns).items()
    ]
    print_table("Speedup of chcrt over tracing from the root: medians over scenes and views, by kind", columns, rows)
    print_notes([
        (f"over {SINGLE}", f"chcrt traces with the kernels of {FRUSTA}, so most of this speedup is that of frusta"),
        (f"over {FRUSTA}", "the same kernel with and without CHC+RT, as in the paper"),
        ("the abstract's", f"{chcrt_published.BEST} is the paper's largest, of diffuse rays in one view"),
    ])  # fmt: skip


def published_speedups(kind: str) -> list[float]:
    """The paper's speedups for a ray kind; it has none for soft shadows."""
    return chcrt_published.speedups(chcrt_published.KINDS.index(kind)) if kind in chcrt_published.KINDS else []


def _print_phases(turns: list[Turn]) -> None:
    """Print Fig. 8 as a table."""
    columns = [_named(name) for name in (*_ROW, "method")]
    columns += [_typical(phase, phase) for phase in (*walkthrough_timing.PHASES, "before")]
    where = "out of core" if _is_paged(turns) else "in memory"
    title = f"Milliseconds per frame by phase, {where}: previously visible, queries, newly visible (Figure 8)"
    print_table(title, [*columns, _typical("all")], _with_statistics(turns))


_COUNTS = {"queries": "queries", "multi_queries": "multi-queries"} | {
    name: name for name in ("traced pairs", "visible", "invisible")
}


def _rate(published: Callable[[Any], str] | None = None) -> TableColumn:
    """A column of millions of rays per second."""
    return _by_turns(
        "M rays/s", lambda mine: f"{mine[-1].rays / walkthrough_timing.typical(mine) / 1e6:.2f}", published
    )


def _print_queries(turns: list[Turn]) -> None:
    """Print the counts of queries in memory."""
    columns = (*map(_named, _ROW), _rate(), *columns_of(_COUNTS, _count))
    print_table("Rays, queries and pairs per frame, in memory", columns, _with_statistics(turns))


def _print_paged_queries(turns: list[Turn]) -> None:
    """Print Table 3."""
    bytes_read = {"bytes": "MB moved", "bvh_bytes": "BVH", "geometry_bytes": "geometry"}
    columns = (
        *_PUBLISHED_ROW,
        _named("method"),
        _rate(item(3)),
        *columns_of(_COUNTS, _count, lambda row, name: row[4] if name == "queries" else ""),
        *columns_of(bytes_read, _megabytes, lambda row, name: row[5 + list(bytes_read).index(name)]),
    )

    def figures(name: str, v: int, k: int) -> tuple[str, ...]:
        rates, queries, megabytes = chcrt_published.STATISTICS[name]
        moved = (f"{mb[v][k]:,.2f}" for mb in (megabytes, *chcrt_published.MOVED[name]))
        return f"{rates[v][k]:.2f}", f"{queries[v][k]:,.0f}", *moved

    published = _published((name, partial(figures, name)) for name in chcrt_published.STATISTICS)
    title = "Rays, queries, pairs, and bytes read from a store, per frame (Table 3)"
    print_table(title, columns, _with_statistics(turns), published)


def _megabytes(group: Group, name: str) -> str:
    """The median of a number of bytes, in MB."""
    return f"{walkthrough_timing.typical(group[1], name) / 1e6:,.2f}"


def _print_randomisation(turns: list[Turn]) -> None:
    """Print Table 5."""
    times = lambda group: [
        walkthrough_timing.typical(walkthrough_timing.of(group[1], sampler=sampler))
        for sampler in walkthrough_timing.SAMPLERS
    ]
    ratio = lambda seconds: f"{seconds[-1] / seconds[0]:.2f}"
    heads = dict(enumerate(("none", "18 degrees", "36 degrees", "full")))
    columns = (
        _named("scene", 0),
        _named("kind", 1),
        *columns_of(heads, lambda group, k: ms(times(group)[k]), lambda row, k: f"{row[2][k]:,}"),
        TableColumn("full / none", lambda group: ratio(times(group)), lambda row: ratio(row[2])),
    )
    published = [(f"(paper: {name})", kind, theirs) for (name, kind), theirs in chcrt_published.RANDOMISATION.items()]
    title = "Milliseconds per frame, near walk, by rotation of directions between pixels (Table 5)"
    print_table(title, columns, _groups(turns, *_ROW), published)


def _print_aggressive(turns: list[Turn]) -> None:
    """Print Table 4."""

    def ratio(group: Group) -> str:
        exact = walkthrough_timing.of(turns, **{**group[0], "method": walkthrough_timing.CHCRT})
        return f"{walkthrough_timing.typical(exact) / walkthrough_timing.typical(group[1]):.2f}"

    def missed(mine: list[Turn]) -> str:
        return f"{100 * sum(t.differs for t in mine) / max(sum(t.rays for t in mine), 1):.3f}"

    columns = (
        _named("scene", 0),
        _named("view", 1),
        _named("method", 2),
        _typical("ms", published=item(3)),
        TableColumn("speedup", ratio, item(4)),
        _by_turns("% rays that differ", lambda mine: "" if _is_paged(mine) else missed(mine)),
        _by_turns("error", lambda mine: f"{fmean(t.error or 0.0 for t in mine):.3f}"),
        _by_turns("MB read", lambda m: f"{walkthrough_timing.typical(m, 'bytes') / 1e6:,.1f}" if _is_paged(m) else ""),
    )
    published = [
        (f"(paper: {name})", view, f"{threshold} pixels", f"{times[v]:,}", f"{thresholds[0][v] / times[v]:.2f}")
        for name, thresholds in chcrt_published.AGGRESSIVE.items()
        for v, view in enumerate(("near", "far"))
        for threshold, times in thresholds.items()
    ]
    title = "Diffuse rays in aggressive mode (Table 4); error: mean absolute difference on a scale of 0 to 255"
    print_table(title, columns, _groups(turns, "scene", "view", "method"), published)
    print_notes([("the paper's error", f"{chcrt_published.ERROR} with 20 pixels")])


def _print_ablation(turns: list[Turn]) -> None:
    """Print the ablation."""

    def ratio(group: Group) -> str:
        base = walkthrough_timing.of(turns, **{**group[0], "method": BASELINE})
        return f"{walkthrough_timing.typical(group[1]) / walkthrough_timing.typical(base):.2f}"

    counts = {"queries": "queries", "traced pairs": "traced pairs", "visible": "visible pairs"}
    total = lambda mine: f"{sum(t.statistics['bytes'] for t in mine) / 1e6:,.1f}" if _is_paged(mine) else ""
    columns = (
        *map(_named, _ROW),
        _named("CHC+RT", name="method"),
        _FIRST._replace(head="ms first"),
        _typical("ms"),
        TableColumn("ratio", ratio),
        *columns_of(counts, _count),
        *([_by_turns("total MB read", total)] if _is_paged(turns) else []),
        _FRAMES,
    )
    title = "Ablation: CHC+RT without single features or with other parameters, per frame; ratio of times to default"
    print_table(title, columns, _with_statistics(turns))
    claim = f"the screen hierarchy makes Powerplant {chcrt_published.SCREEN_HIERARCHY} times as fast (Section 6)"
    print_notes([("in the paper", claim)])


def _print_store(turns: list[Turn]) -> None:
    """Print the chunks and bytes read under both eviction policies."""
    mean = lambda mine, name: fmean(t.statistics[name] for t in walkthrough_timing.later(mine))
    columns = (
        *map(_named, _ROW),
        _named("eviction", name="method"),
        _by_turns("chunks read first", lambda mine: f"{mine[0].statistics['loaded']:,}"),
        _by_turns("MB read first", lambda mine: f"{mine[0].statistics['bytes'] / 1e6:,.1f}"),
        _FIRST._replace(head="ms first"),
        _typical("ms"),
        _by_turns("chunks requested", lambda mine: f"{mean(mine, 'wanted'):,.1f}"),
        _by_turns("% resident", lambda mine: f"{100 * hit_rate(walkthrough_timing.later(mine)):.2f}"),
        _by_turns("chunks read", lambda mine: f"{mean(mine, 'loaded'):,.1f}"),
        _by_turns("MB read", lambda mine: f"{mean(mine, 'bytes') / 1e6:,.2f}"),
    )
    title = "Paging from a store: the first frame, and the mean of later frames (ms: median)"
    print_table(title, columns, _with_statistics(turns))


def _print_mapped(turns: list[Turn]) -> None:
    """Print CHC+RT beside the memory-mapped tree, cold and warm."""
    first = lambda mine: walkthrough_timing.of(mine, frame=0)
    read = lambda mine, value: f"{value / 1e6:,.1f}" if _is_paged(mine) else ""
    columns = (
        *map(_named, _ROW),
        _named("method"),
        _by_turns("MB read first", lambda mine: read(mine, sum(t.statistics.get("bytes", 0) for t in first(mine)))),
        _FIRST._replace(head="ms first"),
        _by_turns("MB read", lambda mine: read(mine, walkthrough_timing.typical(mine, "bytes"))),
        _typical("ms"),
        _FRAMES,
    )
    title = "A naive rival: the same tree in memory-mapped files, traced from the root"
    print_table(title, columns, _groups(turns, *_ROW, "method"))
    print_notes([
        ("chcrt", "MB requested from the store's file, within its memory limit"),
        (mapped_tree.NAME, "MB read from storage by page faults, with pages read ahead; no memory limit applies"),
        ("first frame", "with no page of the file in the cache of the operating system; kinds follow each other"),
        ("without rival", "stores whose whole tree exceeds the memory limit"),
    ])  # fmt: skip


def _print_rival(turns: list[Turn]) -> None:
    """Print CHC+RT beside a tracer with the same memory limit that pages on demand."""
    sums = lambda mine, value: sum(t.statistics[value] for t in mine) / len(mine)
    columns = (
        *map(_named, _ROW),
        _named("method"),
        _FIRST._replace(head="ms first"),
        _typical("ms"),
        _by_turns("MB read per frame", lambda mine: f"{sums(mine, 'bytes') / 1e6:,.1f}"),
        _by_turns("chunks read per frame", lambda mine: f"{sums(mine, 'loaded'):,.0f}"),
        _FRAMES,
    )
    title = "A rival with the same memory limit: diffuse rays, block by block"
    print_table(title, columns, _groups(turns, *_ROW, "method"))
    text = "the same kernel and chunks, but blocks of 32 rows of each pass end one after the other: paging on demand"
    print_notes([(store_walkthroughs.RIVAL, text)])


def _print_bounces(turns: list[Turn]) -> None:
    """Print the bytes read per bounce, with paths in the order of pixels and sorted."""
    columns = (
        *map(_named, _ROW),
        _named("method"),
        _by_turns("rays", lambda mine: f"{mine[0].rays:,}"),
        _by_turns("MB read first", lambda mine: f"{mine[0].statistics['bytes'] / 1e6:,.1f}"),
        _FIRST._replace(head="ms first"),
        TableColumn("MB read", lambda group: _megabytes(group, "bytes")),
        _typical("ms"),
        TableColumn("queries", lambda group: _count(group, "queries")),
        _by_turns("differ", lambda mine: f"{sum(t.differs for t in mine):,}"),
    )
    title = "Diffuse paths of several bounces out of core; differ: hits other than in memory"
    print_table(title, columns, _groups(turns, *_ROW, "method"))


Printer = Callable[[list[Any]], None]

IN_MEMORY: dict[ChcrtTable, tuple[Printer, ...]] = {
    ChcrtTable.times: (_print_times, _print_speedups),
    ChcrtTable.phases: (_print_phases,),
    ChcrtTable.queries: (_print_queries,),
}
OUT_OF_CORE: dict[ChcrtTable, tuple[Printer, ...]] = {
    ChcrtTable.times: (_print_paged_times,),
    ChcrtTable.phases: (_print_phases,),
    ChcrtTable.queries: (_print_paged_queries,),
    ChcrtTable.store: (_print_store,),
}
"""The printers of WALKED tables, for turns in memory and out of core."""

OTHERS: dict[ChcrtTable, Printer] = {
    ChcrtTable.scenes: _print_scenes,
    ChcrtTable.randomisation: _print_randomisation,
    ChcrtTable.aggressive: _print_aggressive,
    ChcrtTable.ablation: _print_ablation,
    ChcrtTable.rival: _print_rival,
    ChcrtTable.bounces: _print_bounces,
}


def print_tables(tables: Iterable[ChcrtTable], rows: TableRows) -> None:
    """Print the requested tables that were measured."""
    in_memory, paged = rows.get(ChcrtTable.times, []), rows.get(ChcrtTable.store, [])
    for table in tables:
        printers = [(printer, in_memory) for printer in IN_MEMORY.get(table, ())]
        printers += [(printer, paged) for printer in OUT_OF_CORE.get(table, ())]
        if table in OTHERS:
            printers.append((OTHERS[table], rows.get(table, [])))
        if table == ChcrtTable.mapped:
            ours = [
                turn._replace(method=walkthrough_timing.CHCRT)
                for turn in walkthrough_timing.of(paged, method=POLICIES[0])
            ]
            printers.append((_print_mapped, ours + rows.get(table, [])))
        for printer, turns in printers:
            if turns:
                printer(turns)
