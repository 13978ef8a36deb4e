"""Measures the tables of ``antumbra bench chc-rt``, in memory and out of core.

They include the sizes of scenes [Mattausch et al. 2015, Table 1] and an ablation: CHC+RT with single features disabled
or other parameters (Sec. 4.4, 4.5, 5.1, 5.2, 6). The medians of each walkthrough are shown as soon as it ends.
"""

import sys
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from functools import cache, partial
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

from ....base.files import temporary_folder
from ....engine.scene_loading import load
from ....engine.store_building import build_store
from ....generate.generated_scene import StreamedCity
from ....store.store_build import CHUNK
from ....store.store_format import chunk_places
from ....store.system_resources import MAX_MEMORY
from ....techniques.tracer_options import WHOLE_SCREEN
from ...bench_parts import BenchParts
from ..bench_runner import ROUNDS, Say
from ..benchmark_views import agree, scene_view
from . import store_walkthroughs, walkthrough_timing
from .chcrt_figures import FIGURES, name_of, write_pictures
from .chcrt_published import WALKED, ChcrtTable
from .mapped_tree import whole_tree, write_tree
from .store_walkthroughs import MakeCase, StoreCase
from .walkthrough_timing import Digests, InCore, Pace, Turn, Walked, Walks
from .walkthroughs import AO, DIFFUSE, NEAR, SAMPLER, SOFT, WalkPlace, place_of

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
    "parts of 16 levels": {"height": 16},
    "parts of 32 levels": {"height": 32},
    "no optimised tree": {"build": "bsah"},
}
"""Variant -> what it changes, as for `InCore.culling_by`."""

_MOST = 12  # first frames of a walkthrough that each variant traces, so camera steps are as small as in the others


def ablate_in_memory(place: WalkPlace, core: Callable[[], InCore], pace: Pace, say: Say) -> Walks:
    """The near walkthrough by all variants, alternating within each frame."""

    def measure() -> Walked:
        built = core()
        methods = [built.culling_by(name, changed) for name, changed in VARIANTS.items()]
        shorter = pace.shorter()._replace(most=_MOST)
        walk, kinds = place.walk(NEAR), (AO, DIFFUSE, SOFT)
        turns = walkthrough_timing.walk_through(built, walk, methods, kinds, SAMPLER, shorter, say)
        return Walked(turns, [], compared=True)

    yield NEAR, measure


def ablate_out_of_core(case: MakeCase, size: tuple[int, int], pace: Pace, say: Say) -> Walks:
    """The near walkthrough by each variant, starting with no chunk in memory.

    A store's parts are its chunks, so variants with other parts or trees are skipped. The rest trace as many frames as
    the first variant reaches within the time limit.

    size : (width, height) of the images
    """

    def measure() -> Walked:
        made, turns, digests = case(), list[Turn](), Digests()
        made = made._replace(place=made.place.resized(*size))
        limited = pace.shorter()._replace(most=_MOST)
        for name, changed in VARIANTS.items():
            if {"triangles", "height", "build"} & changed.keys():
                continue
            with store_walkthroughs.opened(made) as paged:
                scheduled = paged.accelerated.prepared
                scheduled.options = scheduled.options._replace(**changed)
                near = made.place.walk(NEAR)
                walked = store_walkthroughs.walk_through_store(made, near, paged, name, limited, say)
            limited = limited._replace(most=1 + walked.turns[-1].frame, limit=inf)
            turns, digests = turns + walked.turns, digests + walked.digests
        return Walked(turns, digests)

    yield NEAR, measure


# --- Measures the requested tables ------------------------------------------------------------------------------------


TableRows = dict[ChcrtTable, list[Any]]
"""`Turn`s of each measured table; `SceneSize`s for `scenes`. `times` has the turns in memory of all WALKED tables, and
`store` those out of core."""

ROWS = Turn, Walked, SceneSize
"""The rows in parts."""


def show_medians(turns: list[Turn]) -> None:
    """Print a line per method and ray kind to standard error, above the progress line."""
    for row in walkthrough_timing.rows_of(turns, "scene", "view", "sampler", "kind", "method"):
        mine = walkthrough_timing.of(turns, **row)
        names = [value for value in row.values() if value != SAMPLER]
        text = f"{', '.join(names)}: {1e3 * walkthrough_timing.typical(mine):,.1f} ms per frame ({len(mine)} frames)"
        print(text, file=sys.stderr, flush=True)


class ChcrtRun(NamedTuple):
    """What to measure, and how to show it."""

    parts: BenchParts
    policies: Sequence[str]  # of eviction, to measure out of core
    threads: int
    ablation_size: tuple[int, int]  # (width, height) of the images of the ablation
    pace: Pace
    say: Say
    show: Callable[[list[Turn]], None]  # called with the turns of each walkthrough as soon as it ends
    pictures: Path | None = None  # folder for the figures of scenes in memory

    def add(self, table: ChcrtTable, scene: str, walks: Walks, **settings: Any) -> None:
        """Measure walkthroughs, each a part with further settings."""
        for name, measure in walks:
            self.parts.add(table, f"{scene}, {name}", partial(self._shown, measure), **settings)

    def _shown(self, measure: Callable[[], Walked]) -> Walked:
        walked = measure()
        self.show(walked.turns)
        return walked


def tables_of(wanted: Iterable[ChcrtTable]) -> list[ChcrtTable]:
    """The tables with parts of their own from which the wanted tables are printed."""
    needed = {*wanted}
    needed |= {ChcrtTable.times, ChcrtTable.store} if WALKED & needed else set()
    needed |= {ChcrtTable.store} if ChcrtTable.mapped in needed else set()
    return [table for table in ChcrtTable if table in needed - {ChcrtTable.phases, ChcrtTable.queries}]


def add_in_memory(places: Iterable[WalkPlace], run: ChcrtRun) -> None:
    """Measure scenes in memory."""
    pace, say = run.pace, run.say
    for place in places:
        built = cache(partial(_built, place, run))
        name = place.name
        triangles = place.scene.n_triangles
        run.parts.add(ChcrtTable.scenes, name, partial(_measured_size, built), triangles=triangles)
        for table, walks in {
            ChcrtTable.times: walkthrough_timing.times(place, built, pace, say),
            ChcrtTable.randomisation: walkthrough_timing.randomisation(place, built, pace, say),
            ChcrtTable.aggressive: walkthrough_timing.aggressive(place, built, pace, say),
            ChcrtTable.ablation: ablate_in_memory(place.resized(*run.ablation_size), built, pace, say),
        }.items():
            run.add(table, name, walks, triangles=triangles)
        if run.pictures is not None and not (run.pictures / name_of(name, FIGURES[0])).exists():
            built()


def _built(place: WalkPlace, run: ChcrtRun) -> InCore:
    run.say(f"{place.name}, building")
    core = InCore(place, run.threads)
    if run.pictures is not None:
        write_pictures(core, run.pictures, run.say)
    return core


def _measured_size(core: Callable[[], InCore]) -> list[SceneSize]:
    return [size_in_memory(core())]


_WHOLE_BYTES = 300  # memory per triangle for the whole tree of a store, in both forms of `mapped_tree.MappedTree`


def add_out_of_core(
    scene: str, triangles: int, memory: int | None, share: float | None, case: MakeCase, run: ChcrtRun
) -> None:
    """Measure a store.

    The ordinary tracer is compared if its tree fits in the memory limit.

    scene : names the store's parts
    triangles : about the number of its triangles
    memory, share : see `StoreCase`
    """
    pace, say = run.pace, run.say
    whole = triangles * _WHOLE_BYTES <= (memory or MAX_MEMORY)

    def longest() -> Pace:
        turns = [t for walked in run.parts.values(ChcrtTable.store) for t in walked.turns]
        return pace._replace(most=1 + max(t.frame for t in turns if t.scene == case().place.name))

    with ExitStack() as stack:

        @cache
        def written() -> Path:
            folder = stack.enter_context(temporary_folder())
            say(f"{scene}, writing the tree to be mapped")
            write_tree(whole_tree(case().store), folder, run.threads)
            return folder

        tree = cache(lambda: whole_tree(case().store) if whole else None)
        walks: dict[ChcrtTable, Walks] = {
            ChcrtTable.store: store_walkthroughs.out_of_core(case, pace, run.policies, say),
            ChcrtTable.rival: store_walkthroughs.rival_through(case, pace, say),
            ChcrtTable.mapped: store_walkthroughs.map_through(case, written, longest, say) if whole else (),
            ChcrtTable.bounces: store_walkthroughs.bounce_through(case, tree, pace._replace(most=1 + ROUNDS), say),
            ChcrtTable.aggressive: store_walkthroughs.aggressive_out_of_core(case, pace, say),
            ChcrtTable.ablation: ablate_out_of_core(case, run.ablation_size, pace, say),
        }
        of_scene = {"memory": memory, "share": share, "triangles": triangles}
        run.parts.add(ChcrtTable.scenes, scene, lambda: [size_of_store(case())], **of_scene)
        for table, each in walks.items():
            run.add(table, scene, each, **of_scene)


IN_CORE_SHARE = 0.47
"""Table 1: the share of City-200 in the memory of the GPU."""

_CHUNKS = 32  # least number of chunks of a temporary store


def add_temporary_store(triangles: int, size: tuple[int, int], run: ChcrtRun) -> None:
    """Measure a store of a city with the memory share of City-200. It is built in a temporary folder if needed.

    triangles : about the number of triangles
    size : (width, height) of the images
    """
    with ExitStack() as stack:

        @cache
        def case() -> StoreCase:
            path = stack.enter_context(temporary_folder()) / "city.antumbra"
            run.say("building a store")
            chunk = min(CHUNK, max(triangles // _CHUNKS, 1))
            build_store([StreamedCity(triangles, 0, run.threads)], path, chunk=chunk)
            scene = load(path)
            place = place_of(scene_view(f"store of {scene.n_triangles:,} triangles", scene, size))
            made = StoreCase(place, run.threads, share=IN_CORE_SHARE)
            stack.callback(made.store.close)
            return made

        add_out_of_core(f"store of about {triangles:,} triangles", triangles, None, IN_CORE_SHARE, case, run)


def rows_of(parts: BenchParts) -> tuple[TableRows, bool | None]:
    """(the rows of all parts, whether all answers agree, or None if none are compared)."""
    sizes = {ChcrtTable.scenes: parts.rows(ChcrtTable.scenes)} if ChcrtTable.scenes in parts else {}
    walks: dict[ChcrtTable, list[Walked]] = {
        table: parts.values(table) for table in ChcrtTable if table in parts and table not in sizes
    }
    rows: TableRows = {
        **sizes,
        **{table: [t for each in walked for t in each.turns] for table, walked in walks.items()},
    }
    every = [each for walked in walks.values() for each in walked]
    answers = [(f"{each.turns[0].scene}, {query}", bits) for each in every for query, bits in each.digests]
    compared = any(each.compared for each in every) or len(dict(answers)) < len(answers)
    return rows, agree(answers) and differing(rows) == 0 if compared else None


def differing(measured: TableRows) -> int:
    """The number of rays with different answers by exact methods."""
    turns = (t for name, rows in measured.items() if name != ChcrtTable.scenes for t in rows)
    return sum(t.differs for t in turns if t.error is None)
