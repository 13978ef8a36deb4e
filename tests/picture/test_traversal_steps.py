"""Steps of shadow rays, plan by plan."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.accelerator import Accelerator
from antumbra.engine.method_registry import TRACERS
from antumbra.engine.plan import parse_plan
from antumbra.picture.frame_request import TimeSample
from antumbra.picture.traversal_steps import WINDOW, explain, trace_windows
from antumbra.query.equal_samples import with_distinct_samples
from antumbra.query.shadow_query import segments, with_receivers
from antumbra.trace.counters import BOX_TESTS, COUNTERS, TRIANGLE_TESTS, new_counters
from antumbra.trace.rays.ray_traversal import BUILT, Ordered
from antumbra.trace.rays.single_rays import count_steps
from asking import query_of, true_occlusion

ONE_BY_ONE = "bsah+single:random", "srdh+single", "grid32+lbvh+single:rtsah", "bsah+refit+single"
BUNDLES = "bsah+wide", "grid32+bsah+multifrusta"
SPP = 4


@pytest.fixture(scope="module")
def scene():
    return at.procedural("atrium", triangles=2000)


@pytest.fixture(scope="module")
def moment(scene):
    camera = scene.cameras[0].resized(40, 24)
    return TimeSample(0.0, camera, [scene.lights[0], at.PointLight((0.0, 5.0, 1.0))])


@pytest.fixture(scope="module")
def report(scene, moment):
    return explain(scene, [moment], [*ONE_BY_ONE, *BUNDLES], spp=SPP, threads=2)


def test_rays_are_those_that_are_asked_and_blocked(scene, moment, report):
    rays, blocked, asks = 0, 0, np.zeros((24, 40), bool)
    for light in moment.lights:
        triangles, query = query_of(scene, moment.camera, light, SPP)
        query = with_distinct_samples(query)
        above = segments(query)[1]
        rays, asks = rays + int(above.sum()), asks | above.any(axis=-1)
        blocked += int((true_occlusion(triangles, query)[0] & above).sum())
    assert (report.rays, report.blocked) == (rays, blocked) and 0 < blocked < rays
    assert (report.asks == asks).all() and 0 < asks.sum() < asks.size


@pytest.mark.parametrize("i", range(len(ONE_BY_ONE) + len(BUNDLES)))
def test_the_parts_are_the_whole(report, i):
    one = report.plans[i]
    assert str(one.plan) == [*ONE_BY_ONE, *BUNDLES][i]
    assert one.box_tests > 0 < one.triangle_tests and one.boxes.sum() == pytest.approx(one.box_tests)
    assert (one.boxes[report.asks] > 0).all() and (one.boxes[~report.asks] == 0).all()
    depths = one.depths
    assert depths.histogram.sum() == report.blocked and len(depths.histogram) == depths.deepest + 1
    ends = np.repeat(np.arange(len(depths.histogram)), depths.histogram)
    assert depths.mean == pytest.approx(ends.mean()) and abs(depths.median - np.median(ends)) <= 1
    assert 1 <= depths.frequent <= depths.deepest
    if i < len(ONE_BY_ONE):
        assert one.boxes.sum() == one.classes.sum() == one.box_tests and (one.classes > 0).all()
        assert one.classes[0] == ends.sum()  # the path to a hit is as long as the depth of its leaf
    else:
        assert one.classes is None


def test_rays_that_nothing_blocks_do_not_care_for_the_order(scene, moment):
    orders = [f"bsah+{name}" for name in TRACERS if name.startswith("single")]
    classes = [one.classes for one in explain(scene, [moment], orders, spp=1).plans]
    assert len(classes) > 5 and len({c[2] for c in classes}) == 1 < len({c[1] for c in classes})


def test_a_tree_that_a_device_has_built_ends_blocked_rays_where_that_of_the_cpu_does(scene, moment):
    on_cpu, on_device = explain(scene, [moment], ["lbvh+single", "lbvh+device:host:0"], spp=1).plans
    np.testing.assert_array_equal(on_device.depths.histogram, on_cpu.depths.histogram)
    assert on_cpu.depths.histogram.sum() > 0


def test_frequent_blockers_are_the_fewest_that_block_half(scene, moment, report):
    accelerator = Accelerator(parse_plan(ONE_BY_ONE[0]), 2)
    hits = np.zeros(scene.n_triangles, np.int64)
    for light in moment.lights:
        triangles, query = query_of(scene, moment.camera, light, SPP)
        query = with_distinct_samples(query)
        hits += count_steps(accelerator.build(triangles).prepared, query, len(hits)).hits
    assert hits.sum() == report.blocked and hits[report.frequent].sum() == report.frequent_rays
    assert (np.diff(hits[report.frequent]) <= 0).all() and hits[report.frequent[0]] == hits.max()
    assert report.frequent_rays >= report.blocked / 2 > report.frequent_rays - hits[report.frequent[-1]]
    assert report.plans[0].depths.frequent == report.plans[3].depths.frequent  # the same tree


def test_steps_are_those_that_the_tracer_counts(scene, moment):
    """The tracer traces ray by ray here, so that it tries no last blocker first."""
    accelerator = Accelerator(parse_plan("bsah+single"), 1)
    triangles, query = query_of(scene, moment.camera.resized(8, 6), moment.lights[0], 2)
    ready = accelerator.build(triangles)
    steps = count_steps(Ordered(ready.bvh, BUILT), query, scene.n_triangles)
    counted = np.zeros((6, 8, len(COUNTERS)), np.int64)
    for y, x in np.ndindex(6, 8):
        one = with_receivers(query, lambda array, y=y, x=x: array[y : y + 1, x : x + 1])
        own = query.samples[(x & 3) + 4 * (y & 3)]
        for s in range(2):
            ray = one._replace(samples=np.ascontiguousarray(np.broadcast_to(own[s : s + 1], (16, 1, 3))))
            accelerator.answer(ready, ray, counted[y, x])
    assert (steps.boxes.sum(axis=-1) == counted[..., BOX_TESTS]).all() and steps.boxes.any()
    assert (steps.triangles == counted[..., TRIANGLE_TESTS]).all()


@pytest.mark.parametrize("tracer", ["single", "wide", "multifrusta", "packet16", "packet16:samples", "packet256"])
@pytest.mark.parametrize("light", [0, 1])
def test_windows_add_up_to_the_tracers_own_counters(scene, moment, tracer, light):
    accelerator = Accelerator(parse_plan(f"bsah+{tracer}"), 2)
    triangles, query = query_of(scene, moment.camera, moment.lights[light], SPP)
    ready, tally = accelerator.build(triangles), new_counters()
    bits, tests = trace_windows(accelerator, ready, query)
    assert (bits == accelerator.answer(ready, query, tally)).all() and bits.any()
    assert (
        tests.shape == (-(-24 // WINDOW), -(-40 // WINDOW), 2)
        and (tests[..., 0] > 0).all()
        and tests.any(axis=(0, 1)).all()
    )
    found, whole = tests.sum(axis=(0, 1)).tolist(), [tally[BOX_TESTS], tally[TRIANGLE_TESTS]]
    if (tracer, light) == ("wide", 1):  # one sample of a point light: packets join tiles of two windows
        assert found == pytest.approx(whole, rel=0.2)
    else:
        assert found == whole


def test_where_nothing_is_asked(scene, moment):
    away = moment._replace(camera=at.Camera((900, 900, 900), (999, 999, 999), width=20, height=10))
    report = explain(scene, [away], ["srdh+single", "bsah+multifrusta"], spp=1)
    assert report.rays == report.blocked == len(report.frequent) == 0 and not report.asks.any()
    for one in report.plans:
        assert one.box_tests == one.triangle_tests == 0 and not one.boxes.any()
        assert np.isnan(one.depths[:3]).all() and one.depths.deepest > 0 and not one.depths.histogram.any()


def test_the_frame_before_is_where_rays_of_the_last_frame_come_from(scene, moment):
    def boxes(*moments):
        rays = at.SrdhRays(last_frame=True)
        return (
            explain(scene, list(moments), [at.Plan(build="srdh", trace="single", sample=rays)], spp=SPP).plans[0].boxes
        )

    elsewhere = moment._replace(camera=at.Camera((0.0, 3.0, 0.0), (0.0, 0.0, 3.0), width=32, height=32))
    alone = boxes(moment)
    assert (alone == boxes(moment, moment)).all() and (alone != boxes(elsewhere, moment)).any()


def test_rays_after_a_bounce(scene, moment):
    def boxes(**asked):
        return (
            explain(scene, [moment], [at.Plan(build="srdh", trace="single", sample=at.SrdhRays(**asked))], spp=SPP)
            .plans[0]
            .boxes
        )

    assert (boxes() != boxes(bounce=True)).any() and (boxes() != boxes(size=4)).any()


def test_plans_that_differ_are_reported(scene, moment, monkeypatch):
    answer = Accelerator.answer

    def wrong(self, *arguments):
        bits = answer(self, *arguments)
        bits[3, 5] ^= np.uint64(self.plan.build == "lbvh")
        return bits

    monkeypatch.setattr(Accelerator, "answer", wrong)
    with pytest.raises(RuntimeError, match=r"bsah\+single and lbvh\+single differ .* 2 pixels.*please report this"):
        explain(scene, [moment], ["bsah+single", "lbvh+single"], spp=1)


def test_rays_for_builders_that_want_none(scene, moment):
    with pytest.raises(at.InputError, match=r"no method in bsah\+single is ray-guided"):
        at.Plan(trace="single", sample=at.SrdhRays())
