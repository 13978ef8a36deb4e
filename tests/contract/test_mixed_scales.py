"""Coordinates of very different sizes: no bit is wrong, and no plan does far more work than the best one."""

from functools import cache

import numpy as np
import pytest

import antumbra as at
import oracle
from antumbra.bvh.wide_bvh import widen
from antumbra.engine.method_registry import BUILDERS
from antumbra.engine.plan import covering_plans
from antumbra.query.light_samples import light_samples
from antumbra.query.ray_list import hit_arrays, rays_of
from antumbra.query.receivers import Receivers
from antumbra.query.shadow_query import segments
from antumbra.scene.triangles import HitFilter
from antumbra.trace.counters import as_dict, new_counters
from antumbra.trace.rays.ray_batches import RayTracer
from asking import answer, query_of

MOST = 10  # times the work of the best plan
PLANS = covering_plans()


def _powers(rng, shape, most=3, low=-30, high=12):
    """Small whole numbers times powers of two, one for each first index."""
    return rng.integers(-most, most + 1, shape) * 2.0 ** rng.integers(
        low, high + 1, (shape[0], *[1] * (len(shape) - 1))
    )


def _soup(seed):
    """Triangles, points and lights of all scales around one point."""
    rng = np.random.default_rng(seed)
    soup = rng.integers(-4, 5, (32, 3, 3)) * 2.0 ** rng.integers(-16, 10, (32, 1, 1))
    return soup, _powers(rng, (256, 3)), at.PointLights(_powers(rng, (16, 3), 2))


def _corners(seed):
    """Triangles whose corners are of different scales."""
    rng = np.random.default_rng(seed)
    return _powers(rng, (120, 3)).reshape(40, 3, 3), _powers(rng, (64, 3)), at.PointLights(_powers(rng, (15, 3)))


def _far_lights(seed):
    """An ordinary scene under lights, one of which is a billion times as far away as the others."""
    rng = np.random.default_rng(seed)
    soup = rng.normal(size=(200, 1, 3)) * 4 + rng.normal(size=(200, 3, 3))
    lights = np.append(rng.normal(size=(15, 3)) * 4, [[1.0, 2.0**32, 1.0]], 0)
    return soup, rng.normal(size=(64, 3)) * 4, at.PointLights(lights)


def _lamp(seed):
    """A tiny lamp among triangles of all scales."""
    soup, points, _ = _soup(seed)
    return soup, points[:64], at.QuadLight(*np.array([[-1, 4, -1], [2, 0, 0], [0, 0, 2]]) * 2.0**-26)


def _raster(seed, step=-9999.0):
    """Heights of 0 to 5, a tenth of which are replaced by a number that stands for missing data, under suns."""
    rng = np.random.default_rng(seed)
    heights = np.where(rng.random((24, 24)) < 0.1, step, rng.uniform(0, 5, (24, 24)))
    y, x = np.mgrid[:24, :24]
    grid = np.stack([x, y, heights], -1)
    a, b, c, d = grid[:-1, :-1], grid[:-1, 1:], grid[1:, :-1], grid[1:, 1:]
    soup = np.concatenate([np.stack(each, 2).reshape(-1, 3, 3) for each in ((a, c, d), (a, d, b))])
    middle = np.where(np.arange(64) < 32, max(step, 1.0), 1.0)[:, None]  # half of the points are beside the steps
    points = np.append(rng.uniform(0, 23, (64, 2)), rng.uniform(0.5, 0.6, (64, 1)) * np.maximum(middle, 10.0), 1)
    turns, heights = rng.uniform(0, 2 * np.pi, 64), rng.uniform(0.05, 1.5, 64)
    sun = np.stack([np.cos(turns) * np.cos(heights), np.sin(turns) * np.cos(heights), np.sin(heights)], 1)
    return soup, points, at.DirectionalLights(sun)


SCENES = {
    **{f"soup {seed}": (_soup, seed) for seed in (2, 3)},  # 3: frusta once traced the same blocks again and again
    **{f"corners {seed}": (_corners, seed) for seed in (0, 1)},
    "one far light": (_far_lights, 0),
    "tiny lamp": (_lamp, 0),
    "raster, -9999": (_raster, 0),
    **{f"raster, {step:g}": (lambda seed, step=step: _raster(seed, step), 1) for step in (1e6, 1e9, 1e15)},
}


@cache
def _asked(name):
    """(scene, shadow query) of generated points and lights."""
    make, seed = SCENES[name]
    soup, points, light = make(seed)
    scene = at.Scene.from_arrays(soup)
    receivers = Receivers.in_space(points, scene.origin)
    return scene, scene.engine.queries(receivers, [light], [light_samples(light, 16)])[0]


def work_of(counters, plan):
    """The counted work, roughly in nanoseconds: of one box or triangle at a time, of eight, or of 16 rays at a time."""
    c = as_dict(counters)
    rare = 60 * c["uncertain"] + 1000 * c["exact"]
    if plan.trace == "single":
        return 10 * c["box_tests"] + 10 * c["triangle_tests"] + rare
    if plan.trace == "wide":
        return 20 * c["nodes"] + 15 * c["box_tests"] + 25 * c["triangle_tests"] + rare
    return 50 * c["nodes"] + 3 * c["triangles"] + 25 * c["triangle_tests"] + rare


@cache
def _answers(name):
    """Plan -> (work, bits)."""
    scene, query = _asked(name)
    found = {}
    for plan in PLANS:
        counters = new_counters()
        bits = answer(plan, scene.triangles(), query, 1, counters)
        found[plan] = work_of(counters, plan), bits
    return found


@pytest.mark.parametrize("name", SCENES)
def test_every_plan_has_the_bits_of_real_arithmetic(name):
    """The oracle judges some of the points, because it takes minutes for ground that rounding puts in one plane."""
    scene, query = _asked(name)
    n = 1 if name == "raster, 1e+15" else 32
    ends, above = (each[0, :n] for each in segments(query))
    assert above.all()
    origins = np.broadcast_to(query.origins[0, :n, None], ends.shape)
    truth = oracle.occluded(scene.triangles().vertices, origins.reshape(-1, 3), ends=ends.reshape(-1, 3))
    first = _answers(name)[PLANS[0]][1]
    assert first.any() and not first.all()
    for plan, (_, bits) in _answers(name).items():
        np.testing.assert_array_equal(bits[0, :n].ravel(), truth, err_msg=str(plan))
        np.testing.assert_array_equal(bits, first, err_msg=str(plan))


@pytest.mark.parametrize("name", SCENES)
def test_no_plan_does_ten_times_the_counted_work_of_the_best_one(name):
    """No counter has the tests of triangles whose bounds a ray misses, which take a few divisions each."""
    works = {str(plan): work for plan, (work, _) in _answers(name).items()}
    best = min(works.values())
    assert best > 0
    assert {plan: work / best for plan, work in works.items() if work > MOST * best} == {}


# --- Far lights and long rays -----------------------------------------------------------------------------------------


def _wide_scene(rng):
    """A flat scene, many boxes wide."""
    soup = rng.normal(size=(600, 1, 3)) * (40, 2, 40) + rng.normal(size=(600, 3, 3))
    return at.Scene.from_arrays(soup), rng.normal(size=(64, 3)) * (40, 2, 40)


@pytest.mark.parametrize("plan", PLANS, ids=str)
def test_far_lights_cost_no_more_than_near_ones(plan):
    """Otherwise, plans that test all triangles would be seen only in scenes of many triangles."""
    rng = np.random.default_rng(0)
    scene, points = _wide_scene(rng)
    receivers, ways, works = Receivers.in_space(points, scene.origin), rng.normal(size=(16, 3)) + (0, 2, 0), []
    for distance in (2.0**8, 2.0**24, 2.0**36):
        light, counters = at.PointLights(ways * distance), new_counters()
        query = scene.engine.queries(receivers, [light], [light_samples(light, 16)])[0]
        answer(plan, scene.triangles(), query, 1, counters)
        works.append(work_of(counters, plan))
    most = 4 if plan.trace.endswith("by-sample") else 2  # far from its light, a frustum is as wide as float32 rounds
    assert 0 < max(works) < most * works[0]


@pytest.mark.parametrize("any_hit", [True, False])
def test_ray_lists_visit_the_same_nodes_whatever_the_length_of_directions(any_hit):
    rng = np.random.default_rng(1)
    scene, origins = _wide_scene(rng)
    tracer = RayTracer(widen(BUILDERS["bsah"].build(scene.triangles().vertices, 1), 1))
    directions, works = rng.normal(size=(64, 3)), []
    for exponent in (0, 43, 100, -43, -70):
        rays = rays_of(origins, directions * 2.0**exponent, HitFilter(), tuple(scene.origin), scene.n_triangles)
        counters = new_counters()
        assert tracer.trace(rays, any_hit, hit_arrays(64, any_hit), 1, counters)
        works.append([as_dict(counters)[name] for name in ("nodes", "triangle_tests", "uncertain")])
    assert works[0][0] > 64
    assert all(work == works[0] for work in works)


def test_a_long_axis_does_not_widen_boxes_along_the_others():
    """A step of 1e9 in a raster. Half of a scene that is flat but for the step stays apart from the rays."""
    works = []
    for step in (10.0, 1e9):
        soup, _, _ = _raster(0, step)
        scene = at.Scene.from_arrays(soup)
        tracer = RayTracer(widen(BUILDERS["bsah"].build(scene.triangles().vertices, 1), 1))
        origins = np.array([[3.3, 4.4, scene.bounds[1, 2] * 2]]) + np.zeros((64, 1))
        rays = rays_of(origins, np.array([0.0, 0.0, -1.0]), HitFilter(), tuple(scene.origin), scene.n_triangles)
        counters = new_counters()
        tracer.trace(rays, False, hit_arrays(64, False), 1, counters)
        works.append(as_dict(counters)["triangle_tests"])
    assert 0 < works[1] < MOST * works[0]


# --- Pictures ---------------------------------------------------------------------------------------------------------


A_RAY = 100  # nanoseconds; `single` takes less where the blocker of one ray blocks the next one too
PICTURES = {"soup": (_soup, 2), "raster, 1e+06": (lambda seed: _raster(seed, 1e6), 1)}


@pytest.mark.parametrize("name", PICTURES)
def test_pictures_have_the_same_bits_by_all_plans_and_no_plan_does_ten_times_the_work(name):
    make, seed = PICTURES[name]
    scene = at.Scene.from_arrays(make(seed)[0])
    triangles, query = query_of(scene, scene.default_camera(24, 16), scene.default_light(), 8)
    assert (query.sides != 0).sum() > 24
    answers, works = [], {}
    for plan in PLANS:
        counters = new_counters()
        answers.append(answer(plan, triangles, query, 1, counters))
        works[str(plan)] = work_of(counters, plan)
    assert answers[0].any()
    for bits in answers[1:]:
        np.testing.assert_array_equal(bits, answers[0])
    best = max(min(works.values()), A_RAY * np.count_nonzero(query.sides) * 8)
    assert {plan: work / best for plan, work in works.items() if work > MOST * best} == {}
