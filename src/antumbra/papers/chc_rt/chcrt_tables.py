"""Measures and prints the tables of ``antumbra bench chc-rt``, with the paper's results.

They include the sizes of scenes [Mattausch et al. 2015, Table 1] and an ablation: CHC+RT with single features disabled
or other parameters (Sec. 4.4, 4.5, 5.1, 5.2, 6). The medians of each walkthrough are shown as soon as it ends.
"""

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from math import inf
from pathlib import Path
from statistics import fmean
from typing import Any, NamedTuple

from ...engine.paged_scene import PagedScene
from ...engine.paged_source import MAX_MEMORY
from ...errors import InputError
from ...store.chunk_residency import POLICIES
from ...store.store_format import chunk_places
from ...techniques.tracer_options import WHOLE_SCREEN
from ..bench_runner import Say, TableColumn, columns_of, item, label, ms, print_notes, print_table
from ..benchmark_views import agree
from . import chcrt_published as paper
from . import walkthrough_timing as bench
from .chcrt_published import WALKED, ChcrtTable
from .walkthrough_timing import Digests, InCore, Pace, Turn, hit_rate
from .walkthroughs import AO, DIFFUSE, PLANS, SAMPLER, SOFT, WalkPlace

# --- Scene sizes ------------------------------------------------------------------------------------------------------


class SceneSize(NamedTuple):
    """The size in bytes of what CHC+RT traces: a scene in memory, or a store's file."""

    scene: str
    triangles: int
    total: int  # with a store's directory and page padding
    bvh: int  # nodes
    geometry: int  # triangles and their colours
    share: float  # memory limit as a share of `total`, at most 1


def size_in_memory(core: InCore) -> SceneSize:
    """The size of a scene in memory."""
    bvh, geometry = core.bytes()
    return SceneSize(core.place.name, core.place.scene.n_triangles, bvh + geometry, bvh, geometry, 1.0)


def size_of_store(place: WalkPlace, max_memory: int | None) -> SceneSize:
    """The size of a store. All of `max_memory` counts towards its share, though rays and images use some of it."""
    scene = place.scene
    if not isinstance(scene, PagedScene):
        raise InputError(f"{place.name}: not a store; use --scene instead of --store")
    chunks, top = scene.store.chunks, scene.store.top
    bvh, geometry = top.nodes.nbytes, 0
    for triangles, nodes, colours in zip(*(a.tolist() for a in (chunks.triangles, chunks.nodes, chunks.colours))):
        at = chunk_places(triangles, nodes, colours)
        bvh, geometry = bvh + at.corners - at.nodes, geometry + at.end - at.corners
    total, most = scene.store.path.stat().st_size, max_memory or scene.max_memory or MAX_MEMORY
    return SceneSize(place.name, scene.n_triangles, total, bvh, geometry, min(most / total, 1.0))


# --- Ablation ---------------------------------------------------------------------------------------------------------


BASELINE = "default"
VARIANTS: dict[str, dict[str, float]] = {
    BASELINE: {},
    "no screen hierarchy": {"tile": WHOLE_SCREEN},
    "no temporal coherence": {"keep": False},
    "no pull-up": {"pull_up": False},
    "t_q 0.125": {"weight": 0.125},
    "t_q 2": {"weight": 2.0},
    "tiles of 64 pixels": {"tile": 64},
    "tiles of 256 pixels": {"tile": 256},
    "parts of 65,536 triangles": {"triangles": 1 << 16},
    "parts of 4 M triangles": {"triangles": 1 << 22},
}
"""Variant -> the options that it changes."""

_MOST = 12  # first frames of a walkthrough that each variant traces, so camera steps are as small as in the others
_SHARE = 4  # a store's walkthrough gets 1 / _SHARE of the time limit


def ablate_in_memory(core: InCore, pace: Pace, say: Say) -> Iterator[list[Turn]]:
    """Measure all variants in the near walkthrough, alternating within each frame."""
    methods = [core.culling_by(name, changed) for name, changed in VARIANTS.items()]
    pace = pace._replace(most=_MOST)
    yield bench.walk_through(core, core.place.walks[0], methods, (AO, DIFFUSE, SOFT), SAMPLER, pace, say)


def ablate_out_of_core(
    place: WalkPlace, max_memory: int | None, threads: int, pace: Pace, say: Say
) -> Iterator[tuple[list[Turn], Digests]]:
    """Measure each variant in the near walkthrough, starting with no chunk in memory.

    A store's parts are its chunks, so variants with other parts are skipped. The rest trace as many frames as the first
    variant reaches within the time limit.
    """
    pace = pace._replace(most=_MOST, limit=pace.limit / _SHARE)
    for name, changed in VARIANTS.items():
        if "triangles" in changed:
            continue
        with bench.opened(place, max_memory, threads) as paged:
            scheduled = paged.accelerated.prepared
            scheduled.options = scheduled.options._replace(**changed)
            turns, digests = bench.walk_through_store(place, place.walks[0], paged, name, pace, say)
        pace = pace._replace(most=1 + turns[-1].frame, limit=inf)
        yield turns, digests


# --- Measures the requested tables ------------------------------------------------------------------------------------


TableRows = dict[ChcrtTable, list[Any]]
"""`Turn`s of each measured table; `SceneSize`s for `scenes`. `times` or `store` has the turns of all WALKED tables."""


def show_medians(turns: list[Turn]) -> None:
    """Print a line per method and ray kind to standard error, above the progress line."""
    for row in bench.rows_of(turns, "scene", "view", "sampler", "kind", "method"):
        mine = bench.of(turns, **row)
        names = [value for value in row.values() if value != SAMPLER]
        text = f"{', '.join(names)}: {1e3 * bench.typical(mine):,.1f} ms per frame ({len(mine)} frames)"
        print(text, file=sys.stderr, flush=True)


class ChcrtRun(NamedTuple):
    """What to measure, and how to show it."""

    tables: Sequence[ChcrtTable]
    threads: int
    pace: Pace
    say: Say
    show: Callable[[list[Turn]], None]  # called with the turns of each walkthrough as soon as it ends
    pictures: Path | None = None  # folder for the figures of scenes in memory
    memory: int | None = None  # memory limit for a store, in bytes


def measure_in_memory(places: Iterable[WalkPlace], run: ChcrtRun) -> tuple[TableRows, bool | None]:
    """Measure scenes in memory: (rows, whether all answers agree, or None without answers)."""
    tables, pace, say = run.tables, run.pace, run.say
    rows: TableRows = {}
    for place in places:
        say(f"{place.name}, building")
        core = InCore(place, run.threads)
        if run.pictures is not None:
            from .chcrt_figures import write_pictures

            write_pictures(core, run.pictures, say)
        if ChcrtTable.scenes in tables:
            rows.setdefault(ChcrtTable.scenes, []).append(size_in_memory(core))
        walks: dict[ChcrtTable, Iterable[list[Turn]]] = {
            ChcrtTable.times: bench.times(core, pace, ChcrtTable.times in tables, say),
            ChcrtTable.randomisation: bench.randomisation(core, pace, say),
            ChcrtTable.aggressive: bench.aggressive(core, pace, say),
            ChcrtTable.ablation: ablate_in_memory(core, pace, say),
        }
        for name, each in walks.items():
            if name in tables or (name == ChcrtTable.times and WALKED.intersection(tables)):
                rows.setdefault(name, []).extend(_gathered(each, run))
    return rows, differing(rows) == 0 if rows.keys() - {ChcrtTable.scenes} else None


def measure_out_of_core(place: WalkPlace, run: ChcrtRun) -> tuple[TableRows, bool | None]:
    """Measure a store: (rows, whether all answers agree, or None if none are compared)."""
    tables, store = run.tables, (place, run.memory, run.threads)
    rows: TableRows = {}
    digests: Digests = []
    if ChcrtTable.scenes in tables:
        rows[ChcrtTable.scenes] = [size_of_store(place, run.memory)]
    if WALKED.intersection(tables):
        policies = POLICIES if ChcrtTable.store in tables else POLICIES[:1]
        walks = bench.out_of_core(*store, run.pace, policies, run.say)
        rows[ChcrtTable.store] = _gathered(_without(digests, walks), run)
    if ChcrtTable.aggressive in tables:
        rows[ChcrtTable.aggressive] = _gathered(bench.aggressive_out_of_core(*store, run.pace, run.say), run)
    if ChcrtTable.ablation in tables:
        walks = ablate_out_of_core(*store, run.pace, run.say)
        rows[ChcrtTable.ablation] = _gathered(_without(digests, walks), run)
    return rows, agree(digests) if {ChcrtTable.store, ChcrtTable.ablation}.intersection(tables) else None


def differing(measured: TableRows) -> int:
    """The number of rays with different answers by exact methods."""
    turns = (t for name, rows in measured.items() if name != ChcrtTable.scenes for t in rows)
    return sum(t.differs for t in turns if t.error is None)


def _gathered(walks: Iterable[list[Turn]], run: ChcrtRun) -> list[Turn]:
    """All turns of the walkthroughs, each shown as soon as it ends."""
    turns: list[Turn] = []
    for walk in walks:
        run.show(walk)
        turns += walk
    return turns


def _without(digests: Digests, walks: Iterable[tuple[list[Turn], Digests]]) -> Iterable[list[Turn]]:
    """Yield the turns of each walkthrough, and append its digests to `digests`."""
    for turns, new in walks:
        digests += new
        yield turns


# --- Prints the tables ------------------------------------------------------------------------------------------------


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
    return _by_turns(head, lambda turns: ms(bench.typical(turns, value)), published)


def _count(group: Group, name: str) -> str:
    """The median of a statistic."""
    return f"{bench.typical(group[1], name):,.0f}"


_FIRST = _by_turns("first frame", lambda turns: ms(bench.first(turns)))
_FRAMES = _by_turns("frames", lambda turns: f"{len(turns)}")
_PUBLISHED_ROW = (_named("scene", 0), _named("view", 1), _named("kind", 2))


def _groups(turns: list[Turn], *fields: str) -> list[Group]:
    """The turns by the values of these fields."""
    return [(row, bench.of(turns, **row)) for row in bench.rows_of(turns, *fields)]


def _with_statistics(turns: list[Turn]) -> list[Group]:
    """The turns with CHC+RT statistics, by scene, view, ray kind and method."""
    return _groups([t for t in turns if t.statistics], *_ROW, "method")


def _published(figures: Iterable[tuple[str, Callable[[int, int], tuple[Any, ...]]]]) -> list[tuple[Any, ...]]:
    """Published rows (scene, view, kind, *figures of view v and kind k) of (scene, function of v and k)."""
    return [
        (f"(paper: {name})", view, kind, *of(v, k))
        for name, of in figures
        for v, view in enumerate(("near", "far"))
        for k, kind in enumerate(paper.KINDS)
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
    print_table(title, columns, sizes, paper.MODELS.items())


def _print_times(turns: list[Turn]) -> None:
    """Print Table 2."""
    (_print_paged_times if _is_paged(turns) else _print_times_in_core)(turns)


def _print_paged_times(turns: list[Turn]) -> None:
    columns = (
        *_PUBLISHED_ROW,
        _named("eviction", name="method"),
        _by_turns("rays", lambda mine: f"{mine[-1].rays:,}"),
        _FIRST,
        _typical("chcrt", published=item(3)),
        _FRAMES,
    )
    published = ((name, lambda v, k, ms=times: (f"{ms[v][k]:,}",)) for name, times in paper.PAGED_TIMES.items())
    title = "Milliseconds per frame, out of core (Table 2)"
    print_table(title, columns, _with_statistics(turns), _published(published))


def _print_times_in_core(turns: list[Turn]) -> None:
    by = {
        (plan, *row.values()): mine
        for plan in (bench.CHCRT, *PLANS)
        for row, mine in _groups(bench.of(turns, method=plan), *_ROW)
    }
    ours = lambda group: by[bench.CHCRT, *group[0].values()]
    theirs = lambda group, plan: by.get((plan, *group[0].values()))

    def speedup(group: Group, plan: str) -> float:
        other = theirs(group, plan)
        return bench.speedup(ours(group), other) if other else 0.0

    def plan_columns(k: int, plan: str) -> tuple[TableColumn, TableColumn]:
        time, ratio = (item(4 + 2 * k), item(5 + 2 * k)) if k < 2 else (None, None)
        return (
            TableColumn(plan, lambda group: ms(bench.typical(other)) if (other := theirs(group, plan)) else "", time),
            TableColumn("ratio", lambda group: f"{speedup(group, plan):.2f}" if theirs(group, plan) else "", ratio),
        )

    columns = (
        *_PUBLISHED_ROW,
        TableColumn("rays", lambda group: f"{ours(group)[-1].rays:,}"),
        TableColumn("first frame", lambda group: ms(bench.first(ours(group)))),
        TableColumn("chcrt", lambda group: ms(bench.typical(ours(group))), item(3)),
        *(column for k, plan in enumerate(PLANS) for column in plan_columns(k, plan)),
        TableColumn("frames", lambda group: f"{len(ours(group))}"),
        _by_turns("differ", lambda mine: f"{sum(t.differs for t in mine)}"),
    )

    def figures(methods: Any, v: int, k: int) -> tuple[str, ...]:
        glsl, chc, cuda = (methods[m][v][k] for m in ("GLSL", "CHC+RT", "CUDA"))
        return f"{chc:,}", f"{glsl:,}", f"{glsl / chc:.2f}", f"{cuda:,}", f"{cuda / chc:.2f}"

    groups = _groups(turns, *_ROW)
    published = _published((name, partial(figures, methods)) for name, methods in paper.TIMES.items())
    title = "Milliseconds per frame, and ratio of the other plans to chcrt in the same frames (Table 2)"
    print_table(title, columns, groups, published)
    print("(paper: the first of the other plans is GLSL, from the root; the second is CUDA)")
    best = max((speedup(group, plan) for group in groups for plan in PLANS), default=0.0)
    print_notes([("largest speedup", f"{best:.2f} over plain tracing (the paper's {paper.BEST})")])


def _print_phases(turns: list[Turn]) -> None:
    """Print Fig. 8 as a table."""
    columns = [_named(name) for name in (*_ROW, "method")]
    columns += [_typical(phase, phase) for phase in (*bench.PHASES, "before")]
    title = "Milliseconds per frame by phase: previously visible, occlusion queries, newly visible (Figure 8)"
    print_table(title, [*columns, _typical("all")], _with_statistics(turns))


def _print_queries(turns: list[Turn]) -> None:
    """Print Table 3."""
    counts = {"queries": "queries", "multi_queries": "multi-queries"}
    counts |= {name: name for name in ("traced pairs", "visible", "invisible")}
    bytes_read = {"bytes": "MB moved", "bvh_bytes": "BVH", "geometry_bytes": "geometry"}
    megabytes = lambda group, name: f"{bench.typical(group[1], name) / 1e6:,.2f}"
    columns = (
        *_PUBLISHED_ROW,
        _named("method"),
        _by_turns("M rays/s", lambda mine: f"{mine[-1].rays / bench.typical(mine) / 1e6:.2f}", item(3)),
        *columns_of(counts, _count, lambda row, name: row[4] if name == "queries" else ""),
        *columns_of(bytes_read, megabytes, lambda row, name: row[5 + list(bytes_read).index(name)]),
    )

    def figures(name: str, v: int, k: int) -> tuple[str, ...]:
        rates, queries, megabytes = paper.STATISTICS[name]
        moved = (f"{mb[v][k]:,.2f}" for mb in (megabytes, *paper.MOVED[name]))
        return f"{rates[v][k]:.2f}", f"{queries[v][k]:,.0f}", *moved

    published = _published((name, partial(figures, name)) for name in paper.STATISTICS)
    title = "Rays, queries, pairs, and bytes read from a store, per frame (Table 3)"
    print_table(title, columns, _with_statistics(turns), published)


def _print_randomisation(turns: list[Turn]) -> None:
    """Print Table 5."""
    times = lambda group: [bench.typical(bench.of(group[1], sampler=sampler)) for sampler in bench.SAMPLERS]
    ratio = lambda seconds: f"{seconds[-1] / seconds[0]:.2f}"
    heads = dict(enumerate(("none", "18 degrees", "36 degrees", "full")))
    columns = (
        _named("scene", 0),
        _named("kind", 1),
        *columns_of(heads, lambda group, k: ms(times(group)[k]), lambda row, k: f"{row[2][k]:,}"),
        TableColumn("full / none", lambda group: ratio(times(group)), lambda row: ratio(row[2])),
    )
    published = [(f"(paper: {name})", kind, theirs) for (name, kind), theirs in paper.RANDOMISATION.items()]
    title = "Milliseconds per frame, near walk, by rotation of directions between pixels (Table 5)"
    print_table(title, columns, _groups(turns, *_ROW), published)


def _print_aggressive(turns: list[Turn]) -> None:
    """Print Table 4."""

    def ratio(group: Group) -> str:
        exact = bench.of(turns, **{**group[0], "method": bench.CHCRT})
        return f"{bench.typical(exact) / bench.typical(group[1]):.2f}"

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
        _by_turns("MB read", lambda m: f"{bench.typical(m, 'bytes') / 1e6:,.1f}" if _is_paged(m) else ""),
    )
    published = [
        (f"(paper: {name})", view, f"{threshold} pixels", f"{times[v]:,}", f"{thresholds[0][v] / times[v]:.2f}")
        for name, thresholds in paper.AGGRESSIVE.items()
        for v, view in enumerate(("near", "far"))
        for threshold, times in thresholds.items()
    ]
    title = "Diffuse rays in aggressive mode (Table 4); error: mean absolute difference on a scale of 0 to 255"
    print_table(title, columns, _groups(turns, "scene", "view", "method"), published)
    print_notes([("the paper's error", f"{paper.ERROR} with 20 pixels")])


def _print_ablation(turns: list[Turn]) -> None:
    """Print the ablation."""

    def ratio(group: Group) -> str:
        base = bench.of(turns, **{**group[0], "method": BASELINE})
        return f"{bench.typical(group[1]) / bench.typical(base):.2f}"

    counts = {"queries": "queries", "traced pairs": "traced pairs", "visible": "visible pairs"}
    read = _by_turns("total MB read", lambda mine: f"{sum(t.statistics['bytes'] for t in mine) / 1e6:,.1f}")
    columns = (
        *map(_named, _ROW),
        _named("CHC+RT", name="method"),
        _FIRST._replace(head="ms first"),
        _typical("ms"),
        TableColumn("ratio", ratio),
        *columns_of(counts, _count),
        *([read] if _is_paged(turns) else []),
        _FRAMES,
    )
    title = "Ablation: CHC+RT without single features or with other parameters, per frame; ratio of times to default"
    print_table(title, columns, _with_statistics(turns))
    claim = f"the screen hierarchy makes Powerplant {paper.SCREEN_HIERARCHY} times as fast (Section 6)"
    print_notes([("in the paper", claim)])


def _print_store(turns: list[Turn]) -> None:
    """Print the chunks and bytes read under both eviction policies."""
    mean = lambda mine, name: fmean(t.statistics[name] for t in bench.later(mine))
    columns = (
        *map(_named, _ROW),
        _named("eviction", name="method"),
        _by_turns("chunks read first", lambda mine: f"{mine[0].statistics['loaded']:,}"),
        _by_turns("MB read first", lambda mine: f"{mine[0].statistics['bytes'] / 1e6:,.1f}"),
        _FIRST._replace(head="ms first"),
        _typical("ms"),
        _by_turns("chunks requested", lambda mine: f"{mean(mine, 'wanted'):,.1f}"),
        _by_turns("% resident", lambda mine: f"{100 * hit_rate(bench.later(mine)):.2f}"),
        _by_turns("chunks read", lambda mine: f"{mean(mine, 'loaded'):,.1f}"),
        _by_turns("MB read", lambda mine: f"{mean(mine, 'bytes') / 1e6:,.2f}"),
    )
    title = "Paging from a store: the first frame, and the mean of later frames (ms: median)"
    print_table(title, columns, _with_statistics(turns))


PRINT: dict[ChcrtTable, Callable[[list[Any]], None]] = {
    ChcrtTable.scenes: _print_scenes,
    ChcrtTable.times: _print_times,
    ChcrtTable.phases: _print_phases,
    ChcrtTable.queries: _print_queries,
    ChcrtTable.randomisation: _print_randomisation,
    ChcrtTable.aggressive: _print_aggressive,
    ChcrtTable.ablation: _print_ablation,
    ChcrtTable.store: _print_store,
}
