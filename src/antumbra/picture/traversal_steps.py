"""Count the traversal steps of shadow rays by plan: per pixel, per class of test, and the depths of frequent blockers.

The tracer `single` and its variants trace one ray at a time, so each test belongs to one ray (see
`trace.rays.single_rays`). Other tracers test boxes for ray bundles, or eight boxes at once. Their queries are traced in
windows of 16 x 16 pixels, each with its own counters, and the tests of a window are divided evenly among its pixels
with shadow rays; the classes of these tests are unknown. A second traversal, one ray at a time, finds the leaf in which
each ray ends.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.wording import counted
from ..engine.accelerator import Accelerated, Accelerator
from ..engine.auto_accelerator import accelerator_of
from ..engine.engine import Engine
from ..engine.plan import Plan, parse_plan
from ..engine.plan_records import precompile_plan
from ..engine.precompilation import precompile
from ..engine.scene import AnyScene
from ..kernels.parallel import thread_count
from ..query.shadow_query import ShadowQuery, with_receivers
from ..scene.lights import check_lights
from ..trace.counters import BOX_TESTS, TRIANGLE_TESTS, new_counters
from ..trace.rays.ray_traversal import BUILT, Ordered
from ..trace.rays.single_rays import Steps, add_steps, count_steps, hit_depths, leaf_depths
from .frame_request import PictureQueries, TimeSample, build_for, picture_queries
from .render_options import RenderOptions

# --- Tests per window -------------------------------------------------------------------------------------------------

WINDOW = 16  # pixels; no ray bundle crosses the border of a window


def trace_windows(
    accelerator: Accelerator, accelerated: Accelerated, query: ShadowQuery
) -> tuple[np.ndarray, np.ndarray]:
    """Trace a query window by window: (bits, tests); tests: (rows, columns, 2) int64, box and triangle tests.

    Windows begin at multiples of 16 pixels, so they contain complete 4 x 4 blocks of interleaved samples, and the bits
    equal those of the query traced at once.
    """
    h, w = query.sides.shape
    rows, columns = -(-h // WINDOW), -(-w // WINDOW)
    bits = np.zeros((h, w, -(-query.samples.shape[1] // 64)), np.uint64)
    tests, single_threaded = np.zeros((rows, columns, 2), np.int64), Accelerator(accelerator.plan, 1)

    def trace(window: int) -> None:
        y, x = divmod(window, columns)
        part = slice(y * WINDOW, (y + 1) * WINDOW), slice(x * WINDOW, (x + 1) * WINDOW)
        tally = new_counters()
        bits[part] = single_threaded.answer(accelerated, with_receivers(query, lambda array: array[part]), tally)
        tests[y, x] = tally[[BOX_TESTS, TRIANGLE_TESTS]]

    with ThreadPoolExecutor(accelerator.threads) as pool:
        list(pool.map(trace, range(rows * columns)))
    return bits, tests


# --- Traversal steps of several plans ---------------------------------------------------------------------------------


class Depths(NamedTuple):
    """Depths of leaves: boxes on the path from the root, including the leaf's. NaN if no ray is blocked."""

    frequent: float  # mean depth of the frequent blockers' leaves, weighted by the rays they block in the first plan
    mean: float  # mean depth of the leaves in which this plan's blocked rays end
    median: float  # median of these depths
    deepest: int  # depth of the deepest leaf of the tree
    histogram: NDArray[np.int64]  # (deepest + 1,) int64: blocked rays that end at each depth


class PlanSteps(NamedTuple):
    """The traversal steps of one plan. H, W: the camera's height and width."""

    plan: Plan
    boxes: NDArray[np.float64]  # (H, W) float64: boxes tested for each pixel's rays
    box_tests: int
    triangle_tests: int
    classes: NDArray[np.int64] | None  # (3,): box tests by `trace.rays.single_rays.CLASSES`; None: tests of bundles
    depths: Depths


class Explanation(NamedTuple):
    """The traversal steps of several plans; all plans give the same bits."""

    asks: NDArray[np.bool_]  # (H, W) bool: pixels with at least one shadow ray
    rays: int  # shadow rays: samples above the horizon, over all lights
    blocked: int  # blocked rays among them
    frequent: NDArray[np.int64]  # (k,): frequent blockers, the fewest triangles that block half of the blocked rays
    frequent_rays: int  # rays blocked by the frequent blockers in the first plan
    plans: list[PlanSteps]


class _CountedTrace(NamedTuple):
    """The result of tracing with one plan."""

    plan: Plan
    accelerated: Accelerated
    steps: Steps  # counted one ray at a time
    bits: list[np.ndarray]
    bundles: NDArray[np.int64] | None  # (rows, columns, 2): box and triangle tests per window; None: counted per ray
    ids: np.ndarray | None = None  # scene indices of the triangles that `steps` counts; None: all triangles


def explain(
    scene: AnyScene,
    moments: Sequence[TimeSample],
    plans: Sequence[str | Plan],
    *,
    spp: int = 16,
    threads: int | None = None,
    say: Callable[[Plan, int], object] | None = None,
) -> Explanation:
    """Count the traversal steps of a picture's shadow rays under several plans.

    Parameters
    ----------
    scene : Scene or PagedScene
        A store always uses its own tree, with the plan ``"bsah+chcrt"``.
    moments : list of TimeSample
        The steps are those of the last time sample. Earlier ones stand for the preceding frames of an animation, which
        supply the trees kept from frame to frame and the rays of the last frame.
    plans : list of str or Plan, one or more
    spp, threads
        As in `antumbra.render`.
    say : function of (plan, its index), optional
        Called before each plan.

    Raises
    ------
    InputError
        If a value is out of range, or a plan is unknown or has no BVH.
    RuntimeError
        If two plans differ in a bit, which is a bug.
    """
    parsed = explained_plans(plans)
    source = scene.engine.source
    for plan in parsed if source.memory is not None else ():
        Engine(scene, plan, threads)  # rejects plans that build another tree than the store's
    moments = [moment._replace(lights=check_lights(moment.lights, scene.up)) for moment in moments]
    for plan in parsed:
        precompile_plan(plan, "raster" if source.memory is None else "rays")
    if source.memory is not None:
        source.warm_up()
    precompile("counted steps")
    if any(plan.sample is not None and plan.sample.bounce for plan in parsed):
        precompile("a diffuse bounce")
    return explain_compiled(scene, moments, parsed, spp, thread_count(threads), say)


def explained_plans(plans: Sequence[str | Plan]) -> list[Plan]:
    """Parse the plans; InputError if one is unknown or has no BVH."""
    parsed = [parse_plan(plan) for plan in plans]
    for plan in parsed:
        if plan.build is None:
            raise InputError(f"plan {str(plan)!r} has no BVH, so its rays take no steps; leave it out")
    return parsed


def explain_compiled(
    scene: AnyScene,
    moments: Sequence[TimeSample],
    plans: Sequence[Plan],
    spp: int,
    threads: int,
    say: Callable[[Plan, int], object] | None = None,
) -> Explanation:
    """`explain` with checked arguments and compiled kernels."""
    pictures = [picture_queries(scene, moment, RenderOptions(spp=spp), threads) for moment in moments]
    plan_steps: list[PlanSteps] = []
    for i, plan in enumerate(plans):
        if say is not None:
            say(plan, i)
        trace = _count_plan(accelerator_of(plan, threads), pictures)
        if i == 0:
            first, frequent = trace, _frequent_blockers(trace.steps.hits)
        _check_bits(first, trace)
        plan_steps.append(_plan_steps(trace, first.steps.hits, frequent))
    steps = first.steps
    has_rays, rays, blocked = steps.rays > 0, int(steps.rays.sum()), int(steps.blocked.sum())
    frequent_ids = frequent if first.ids is None else first.ids[frequent]
    return Explanation(has_rays, rays, blocked, frequent_ids, int(steps.hits[frequent].sum()), plan_steps)


def _count_plan(accelerator: Accelerator, pictures: list[PictureQueries]) -> _CountedTrace:
    """Build for every picture in turn, then trace the last one and count its steps."""
    if pictures[-1].source is not None:
        return _count_plan_in_store(accelerator, pictures[-1])
    for picture in pictures:
        accelerated = build_for(accelerator, picture)
    if accelerator.own_tree:
        accelerated = accelerated._replace(bvh=accelerated.prepared.host_tree)
    assert accelerated.bvh is not None
    queries, n, threads = pictures[-1].queries, len(pictures[-1].triangles.vertices), accelerator.threads
    one_by_one = isinstance(accelerated.prepared, Ordered)
    ordered = accelerated.prepared if one_by_one else Ordered(accelerated.bvh, BUILT)
    steps = add_steps([count_steps(ordered, query, n, threads) for query in queries])
    if one_by_one:
        return _CountedTrace(
            accelerator.plan, accelerated, steps, [accelerator.answer(accelerated, query) for query in queries], None
        )
    bits, tests = zip(*(trace_windows(accelerator, accelerated, query) for query in queries))
    return _CountedTrace(accelerator.plan, accelerated, steps, list(bits), np.sum(tests, axis=0))


def _count_plan_in_store(accelerator: Accelerator, picture: PictureQueries) -> _CountedTrace:
    """Trace a picture of a store, and count the steps of its rays through the store's tree.

    `_CountedTrace.ids` are the scene indices of the triangles in the chunks that rays may enter.
    """
    from ..engine.joined_store_tree import explained_tree

    bvh, ids = explained_tree(picture.source, picture.queries)
    accelerated = picture.source.accelerated
    bits, tests = zip(*(trace_windows(accelerator, accelerated, query) for query in picture.queries))
    faces = picture.queries[0].ids
    places = np.searchsorted(ids, faces)
    known = (faces >= 0) & (np.append(ids, -1)[places] == faces)
    local_ids = np.where(known, places, -1).astype(np.int32)
    ordered, n, threads = Ordered(bvh, BUILT), len(ids), accelerator.threads
    steps = add_steps([count_steps(ordered, q._replace(ids=local_ids), n, threads) for q in picture.queries])
    return _CountedTrace(accelerator.plan, accelerated._replace(bvh=bvh), steps, list(bits), np.sum(tests, axis=0), ids)


def _check_bits(first: _CountedTrace, other: _CountedTrace) -> None:
    """Raise a RuntimeError if two plans give different bits."""
    differ = [np.count_nonzero((a != b).any(axis=-1)) for a, b in zip(first.bits, other.bits)]
    if any(differ):
        raise RuntimeError(
            f"the plans {first.plan} and {other.plan} differ in the shadows of {counted(sum(differ), 'pixel')}, and "
            "no two plans may; please report this with the scene and the command"
        )


def _frequent_blockers(hits: np.ndarray) -> np.ndarray:
    """The fewest triangles that have half of all hits, by decreasing hits."""
    order = np.argsort(-hits, kind="stable")
    cumulative = np.cumsum(hits[order])
    if cumulative.size == 0 or cumulative[-1] == 0:
        return order[:0]
    return order[: int(np.searchsorted(cumulative, cumulative[-1] / 2)) + 1]


def _plan_steps(trace: _CountedTrace, hits: np.ndarray, frequent: np.ndarray) -> PlanSteps:
    """The steps of one plan; `hits`: rays that each triangle blocks in the first plan."""
    steps, depths = trace.steps, _depths(trace, hits, frequent)
    if trace.bundles is None:
        boxes, classes = steps.boxes.sum(axis=-1), steps.boxes.sum(axis=(0, 1))
        tested, triangles = int(classes.sum()), int(steps.triangles.sum())
        return PlanSteps(trace.plan, boxes.astype(np.float64), tested, triangles, classes, depths)
    tested, triangles = (int(n) for n in trace.bundles.sum(axis=(0, 1)))
    return PlanSteps(trace.plan, _window_shares(trace.bundles[..., 0], steps.rays > 0), tested, triangles, None, depths)


def _window_shares(tests: np.ndarray, has_rays: np.ndarray) -> NDArray[np.float64]:
    """(H, W) float64: the tests of each window, divided evenly among its pixels with shadow rays (`has_rays`)."""
    rows, columns = (np.arange(n) // WINDOW for n in has_rays.shape)
    window = rows[:, None] * tests.shape[1] + columns
    n = np.bincount(window[has_rays], minlength=tests.size).reshape(tests.shape)
    return np.where(has_rays, (tests / np.maximum(n, 1)).ravel()[window], 0.0)


def _depths(trace: _CountedTrace, hits: np.ndarray, frequent: np.ndarray) -> Depths:
    """Depths of the leaves in which the blocked rays of one plan end, and of those of the frequent blockers."""
    bvh = trace.accelerated.bvh
    assert bvh is not None
    histogram = hit_depths(bvh, trace.steps.hits)
    cumulative, depth_of = np.cumsum(histogram), np.zeros(len(hits))
    depth_of[bvh.prim_ids] = leaf_depths(bvh)
    deepest = max(len(histogram) - 1, 0)
    if not len(frequent):
        return Depths(np.nan, np.nan, np.nan, deepest, histogram)
    return Depths(
        float(np.average(depth_of[frequent], weights=hits[frequent])),
        float(np.average(np.arange(len(histogram)), weights=histogram)),
        float(np.searchsorted(cumulative, cumulative[-1] / 2)),
        deepest,
        histogram,
    )
