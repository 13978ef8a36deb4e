"""Measures the tables of ``antumbra bench chc-rt``, in memory and out of core.

They include the sizes of scenes [Mattausch et al. 2015, Table 1] and an ablation: CHC+RT with single features disabled
or other parameters (Sec. 4.4, 4.5, 5.1, 5.2, 6). The medians of each walkthrough are shown as soon as it ends.
"""

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

from ....base.files import temporary_folder
from ....engine.scene import procedural
from ....engine.scene_loading import load
from ....engine.sources.paged_source import MAX_MEMORY
from ....engine.store_building import build_store
from ....store.chunk_residency import POLICIES
from ....store.store_build import CHUNK
from ....store.store_format import chunk_places
from ....techniques.tracer_options import WHOLE_SCREEN
from ..bench_runner import Say
from ..benchmark_views import agree, scene_view
from . import store_walkthroughs, walkthrough_timing
from .chcrt_published import IN_CORE, PAGED, WALKED, ChcrtTable
from .mapped_tree import whole_tree, write_tree
from .store_walkthroughs import Digests, StoreCase
from .walkthrough_timing import InCore, Pace, Turn
from .walkthroughs import AO, DIFFUSE, SAMPLER, SOFT, WalkPlace, place_of

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


def size_of_store(case: StoreCase) -> SceneSize:
    """The size of a store. All of its limit counts towards its share, though rays and images use some of it."""
    chunks, top = case.store.chunks, case.store.top
    bvh, geometry = top.nodes.nbytes, 0
    for triangles, nodes, colours in zip(*(a.tolist() for a in (chunks.triangles, chunks.nodes, chunks.colours))):
        at = chunk_places(triangles, nodes, colours)
        bvh, geometry = bvh + at.corners - at.nodes, geometry + at.end - at.corners
    total = case.store.path.stat().st_size
    share = case.share or (case.max_memory or MAX_MEMORY) / total
    return SceneSize(case.place.name, case.place.scene.n_triangles, total, bvh, geometry, min(share, 1.0))


# --- Ablation ---------------------------------------------------------------------------------------------------------


BASELINE = "default"
VARIANTS: dict[str, dict[str, Any]] = {
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
    "no optimised tree": {"build": "bsah"},
}
"""Variant -> what it changes, as for `InCore.culling_by`."""

_MOST = 12  # first frames of a walkthrough that each variant traces, so camera steps are as small as in the others


def ablate_in_memory(core: InCore, pace: Pace, say: Say) -> Iterator[list[Turn]]:
    """Measure all variants in the near walkthrough, alternating within each frame."""
    methods = [core.culling_by(name, changed) for name, changed in VARIANTS.items()]
    pace = pace.shorter()._replace(most=_MOST)
    yield walkthrough_timing.walk_through(core, core.place.walks[0], methods, (AO, DIFFUSE, SOFT), SAMPLER, pace, say)


def ablate_out_of_core(case: StoreCase, pace: Pace, say: Say) -> Iterator[tuple[list[Turn], Digests]]:
    """Measure each variant in the near walkthrough, starting with no chunk in memory.

    A store's parts are its chunks, so variants with other parts or trees are skipped. The rest trace as many frames as
    the first variant reaches within the time limit.
    """
    pace = pace.shorter()._replace(most=_MOST)
    for name, changed in VARIANTS.items():
        if {"triangles", "build"} & changed.keys():
            continue
        with store_walkthroughs.opened(case) as paged:
            scheduled = paged.accelerated.prepared
            scheduled.options = scheduled.options._replace(**changed)
            turns, digests = store_walkthroughs.walk_through_store(case, case.place.walks[0], paged, name, pace, say)
        pace = pace._replace(most=1 + turns[-1].frame, limit=inf)
        yield turns, digests


# --- Measures the requested tables ------------------------------------------------------------------------------------


TableRows = dict[ChcrtTable, list[Any]]
"""`Turn`s of each measured table; `SceneSize`s for `scenes`. `times` has the turns in memory of all WALKED tables, and
`store` those out of core."""


def show_medians(turns: list[Turn]) -> None:
    """Print a line per method and ray kind to standard error, above the progress line."""
    for row in walkthrough_timing.rows_of(turns, "scene", "view", "sampler", "kind", "method"):
        mine = walkthrough_timing.of(turns, **row)
        names = [value for value in row.values() if value != SAMPLER]
        text = f"{', '.join(names)}: {1e3 * walkthrough_timing.typical(mine):,.1f} ms per frame ({len(mine)} frames)"
        print(text, file=sys.stderr, flush=True)


class ChcrtRun(NamedTuple):
    """What to measure, and how to show it."""

    tables: Sequence[ChcrtTable]
    threads: int
    pace: Pace
    say: Say
    show: Callable[[list[Turn]], None]  # called with the turns of each walkthrough as soon as it ends
    pictures: Path | None = None  # folder for the figures of scenes in memory


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
            ChcrtTable.times: walkthrough_timing.times(core, pace, ChcrtTable.times in tables, say),
            ChcrtTable.randomisation: walkthrough_timing.randomisation(core, pace, say),
            ChcrtTable.aggressive: walkthrough_timing.aggressive(core, pace, say),
            ChcrtTable.ablation: ablate_in_memory(core, pace, say),
        }
        for name, each in walks.items():
            if name in tables or (name == ChcrtTable.times and WALKED.intersection(tables, IN_CORE)):
                rows.setdefault(name, []).extend(_gathered(each, run))
    return rows, differing(rows) == 0 if rows.keys() - {ChcrtTable.scenes} else None


_WHOLE_BYTES = 300  # memory per triangle for the whole tree of a store, in both forms of `mapped_tree.MappedTree`


def measure_out_of_core(case: StoreCase, run: ChcrtRun) -> tuple[TableRows, bool | None]:
    """Measure a store: (rows, whether all answers agree, or None if none are compared).

    The ordinary tracer is compared if its tree fits in the memory limit.
    """
    tables, pace, say = run.tables, run.pace, run.say
    whole = _WHOLE_BYTES * case.place.scene.n_triangles <= (case.max_memory or MAX_MEMORY)
    rows: TableRows = {}
    digests: Digests = []
    if ChcrtTable.scenes in tables:
        rows[ChcrtTable.scenes] = [size_of_store(case)]
    if (WALKED | {ChcrtTable.mapped}).intersection(tables):
        policies = POLICIES if ChcrtTable.store in tables else POLICIES[:1]
        rows[ChcrtTable.store] = _gathered(
            _without(digests, store_walkthroughs.out_of_core(case, pace, policies, say)), run
        )
    if ChcrtTable.mapped in tables and whole:
        with temporary_folder() as folder:
            say(f"{case.place.name}, writing the tree to be mapped")
            write_tree(whole_tree(case.store), folder, case.threads)
            frames = pace._replace(most=1 + max(t.frame for t in rows[ChcrtTable.store]))
            walks = store_walkthroughs.map_through(case, folder, frames, say)
            rows[ChcrtTable.mapped] = _gathered(_without(digests, walks), run)
    if ChcrtTable.bounces in tables:
        bvh = whole_tree(case.store) if whole else None
        rows[ChcrtTable.bounces] = _gathered(
            store_walkthroughs.bounce_through(case, bvh, pace._replace(most=2), say), run
        )
    if ChcrtTable.aggressive in tables:
        rows[ChcrtTable.aggressive] = _gathered(store_walkthroughs.aggressive_out_of_core(case, pace, say), run)
    if ChcrtTable.ablation in tables:
        rows[ChcrtTable.ablation] = _gathered(_without(digests, ablate_out_of_core(case, pace, say)), run)
    compared = {ChcrtTable.store, ChcrtTable.ablation, ChcrtTable.mapped}.intersection(tables)
    same = agree(digests) and differing(rows) == 0
    return rows, same if compared or (whole and ChcrtTable.bounces in rows) else None


IN_CORE_SHARE = 0.47
"""Table 1: the share of City-200 in the memory of the GPU."""

_CHUNKS = 32  # least number of chunks of a temporary store


def measure_temporary_store(triangles: int, size: tuple[int, int], run: ChcrtRun) -> tuple[TableRows, bool | None]:
    """Build a store of a city in a temporary folder, and measure it with the memory share of City-200.

    triangles : about the number of triangles
    size : (width, height) of the images
    """
    with temporary_folder() as folder:
        path = folder / "city.antumbra"
        run.say("building a store")
        build_store([procedural("city", triangles=triangles)], path, chunk=min(CHUNK, max(triangles // _CHUNKS, 1)))
        scene = load(path)
        place = place_of(scene_view(f"store of {scene.n_triangles:,} triangles", scene, size))
        case = StoreCase(place, run.threads, share=IN_CORE_SHARE)
        try:
            return measure_out_of_core(case, run)
        finally:
            case.store.close()


def measure_scenes(
    places: Iterable[WalkPlace], stored: int, size: tuple[int, int], run: ChcrtRun
) -> tuple[TableRows, bool | None]:
    """Measure a temporary store of about `stored` triangles, if it is not 0, and then scenes in memory.

    The store comes first, while the process takes little memory.
    """
    nothing: tuple[TableRows, bool | None] = {}, None
    paged, wanted = stored and {*PAGED}.intersection(run.tables), {*IN_CORE}.intersection(run.tables)
    rows, same = measure_temporary_store(stored, size, run) if paged else nothing
    in_memory, same_in_memory = measure_in_memory(places, run) if wanted else nothing
    verdicts = [verdict for verdict in (same, same_in_memory) if verdict is not None]
    merged = {name: [*in_memory.get(name, []), *rows.get(name, [])] for name in (*in_memory, *rows)}
    return merged, all(verdicts) if verdicts else None


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
