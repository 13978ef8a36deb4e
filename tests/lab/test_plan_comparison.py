"""Plans side by side: what is measured, and whether the bits are the same."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.accelerator import Accelerator
from antumbra.engine.plan import parse_plan
from antumbra.engine.store_building import build_store
from antumbra.lab.plan_comparison import Difference, compare, difference, windows_to_pixels
from antumbra.picture.frame import PHASES
from antumbra.picture.frame_request import TimeSample
from antumbra.picture.render_options import EngineOptions
from antumbra.picture.renderer import Renderer
from antumbra.picture.traversal_steps import WINDOW

PLANS = "bsah+single", "grid32+lbvh+multifrusta", "srdh+wide", "cones"
SPP = 4
PLAIN = at.RenderOptions(spp=SPP, antialias=False)


@pytest.fixture(scope="module")
def scene():
    return at.procedural("atrium", triangles=2000)


@pytest.fixture(scope="module")
def moment(scene):
    return TimeSample(0.0, scene.cameras[0].resized(40, 24), [scene.lights[0], at.PointLight((0.0, 5.0, 1.0))])


@pytest.fixture(scope="module")
def found(scene, moment):
    return compare(scene, moment, PLANS, PLAIN, EngineOptions(threads=2, gbuffer="raster"), rounds=2)


@pytest.mark.parametrize("i", range(3))  # `cones` chooses its way by measured times
def test_counters_are_those_of_a_frame(scene, moment, found, i):
    frame = at.render(scene, moment.camera, moment.lights, spp=SPP, plan=PLANS[i], threads=2, counters=True)
    one = found.plans[i]
    assert (str(one.plan), one.rays, one.counters, one.paging) == (PLANS[i], frame.rays, frame.counters, None)
    assert one.tests_per_ray == (frame.counters["box_tests"] + frame.counters["triangle_tests"]) / frame.rays > 0


@pytest.mark.parametrize("i", range(len(PLANS)))
def test_seconds_are_medians_of_the_rounds(found, i):
    one = found.plans[i]
    assert len(one.seconds) == 2 and list(one.medians) == [*PHASES, "total"]
    for phase in one.medians:
        assert one.medians[phase] == pytest.approx(np.median([seconds[phase] for seconds in one.seconds]))
    assert one.rays_per_second == one.rays / one.medians["trace"] > 0
    assert found.fastest.medians["total"] <= one.medians["total"]


def test_tests_of_windows_are_those_of_the_frame(found):
    asks = found.asks
    assert asks.shape == (24, 40) and 0 < asks.sum() < asks.size
    rows, columns = (np.arange(n) // WINDOW for n in asks.shape)
    rays = np.zeros((2, 3))
    np.add.at(rays, (rows[:, None], columns), asks * (SPP + 1))  # of a lamp and a point light
    for one in found.plans[1:3]:  # `single` also tests the last blocker of the window before
        assert one.windows.shape == (2, 3)
        tests = one.counters["box_tests"] + one.counters["triangle_tests"]
        assert (one.windows * rays).sum() == pytest.approx(tests, rel=0.02)  # hard shadows join tiles of two windows
    assert found.plans[3].windows is None


def test_windows_over_their_pixels():
    windows, asks = np.array([[1.0, 2.0], [np.nan, 4.0]]), np.ones((20, 18), bool)
    asks[0, 0] = asks[16:, :16] = False
    over = windows_to_pixels(windows, asks)
    assert over[0, 0] == 0 and over[0, 15] == over[15, 0] == 1 and over[15, 17] == 2 and over[19, 17] == 4
    assert (over[16:, :16] == 0).all()


def test_plans_take_turns_and_every_frame_is_new(scene, moment, monkeypatch):
    drawn, makers, steps = [], [], []
    render = Renderer.render

    def recorded(self, *arguments, **named):
        drawn.append((str(self.plan), named["counters"]))
        makers.append(self)
        return render(self, *arguments, **named)

    monkeypatch.setattr(Renderer, "render", recorded)
    compare(scene, moment, PLANS[:2], at.RenderOptions(spp=1), rounds=3, say=lambda *step: steps.append(step))
    a, b = PLANS[:2]
    assert drawn == [(a, True), (b, True), *[(a, False), (b, False)] * 4]
    assert len({id(maker) for maker in makers}) == len(drawn)
    assert [step[1:] for step in steps] == [(k, len(steps)) for k in range(len(steps))] and len(steps) == 12


def test_all_exact_plans_agree(found):
    assert str(found.reference) == PLANS[0] and found.wrong == []
    assert [one.difference for one in found.plans] == [Difference(0, 0, None)] * len(PLANS)


def _spoilt(monkeypatch, *plans):
    """Flip the first sample's bit of pixel (7, 3) in all answers by these plans."""
    answer = Accelerator.answer_all

    def spoilt(self, accelerated, queries, *rest):
        bits = answer(self, accelerated, queries, *rest)
        if str(self.plan) in plans:
            bits[0][3, 7] ^= np.uint64(1)
        return bits

    monkeypatch.setattr(Accelerator, "answer_all", spoilt)


def test_a_bit_that_differs_is_found(scene, moment, monkeypatch):
    _spoilt(monkeypatch, "bsah+single")
    found = compare(scene, moment, ["bsah+wide", "bsah+single"], PLAIN, rounds=1)
    assert [one.difference for one in found.plans] == [Difference(0, 0, None), Difference(1, 1, (7, 3))]
    assert found.wrong == [found.plans[1]]


def test_a_plan_that_is_not_exact_may_differ_and_is_no_reference(scene, moment, monkeypatch):
    _spoilt(monkeypatch, "bsah+chcrt:20")
    found = compare(scene, moment, ["bsah+chcrt:20", "bsah+chcrt"], PLAIN, rounds=1)
    assert str(found.reference) == "bsah+chcrt" and found.wrong == []
    assert [one.difference.bits for one in found.plans] == [1, 0]
    alone = compare(scene, moment, ["bsah+chcrt:20", "bsah+chcrt:100"], PLAIN, rounds=1)
    assert str(alone.reference) == "bsah+chcrt:20" and alone.wrong == []


def test_colours_that_differ_count_too(found):
    frame = found.frame
    other = frame._replace(image=frame.image.copy())
    other.image[[5, 6], [2, 1], 0] += 1
    assert difference(frame, other) == Difference(0, 2, (2, 5))


def test_options_of_the_frame(scene, moment):
    asked = {"spp": 2, "sampler": "halton", "filter": True, "adaptive": 8, "bounce": 2}
    engine = EngineOptions(threads=1, gbuffer="rays")
    found = compare(scene, moment, PLANS[:2], at.RenderOptions(**asked), engine, rounds=1)
    frame = at.render(scene, moment.camera, moment.lights, plan=PLANS[0], **asked)
    np.testing.assert_array_equal(found.frame.image, frame.image)
    assert found.wrong == [] and found.plans[0].rays == frame.rays > found.asks.sum() * 2 * 2


def _srdh(rays):
    return at.Plan(build="srdh", trace="single", sample=rays)


def test_rays_for_srdh(scene, moment):
    boxes = [
        compare(scene, moment, ["bsah+wide", _srdh(rays)], PLAIN).plans[1].counters for rays in (None, at.SrdhRays(2))
    ]
    assert boxes[0]["box_tests"] != boxes[1]["box_tests"]


def test_a_store(tmp_path):
    scene, path = at.procedural("city", triangles=5_000), tmp_path / "city.antumbra"
    build_store([scene], path, chunk=512)
    moment = TimeSample(0.0, scene.cameras[0].resized(48, 32), [scene.lights[0]])
    found = compare(at.load(path), moment, ["bsah+chcrt", "bsah+chcrt:20"], PLAIN, EngineOptions(threads=2), rounds=1)
    frame = at.render(scene, moment.camera, moment.lights, spp=SPP)
    np.testing.assert_array_equal(found.frame.bits, frame.bits)
    first = found.plans[0]
    assert first.windows.shape == (2, 3) and np.nanmax(first.windows) > 0 < first.paging["loaded"]
    with pytest.raises(at.InputError, match="is in a store"):
        compare(at.load(path), moment, ["bsah+chcrt", "bsah+single"])


def test_nothing_seen(scene):
    away = at.Camera((900, 900, 900), (999, 999, 999), width=20, height=10)
    found = compare(scene, TimeSample(0.0, away, [scene.lights[0]]), PLANS, rounds=1)
    assert not found.asks.any() and found.wrong == []
    for one in found.plans:
        assert (one.rays, one.rays_per_second, one.tests_per_ray) == (0, None, None)
        assert one.windows is None or np.isnan(one.windows).all()


def test_what_is_wrong_is_said_before_anything_is_drawn(scene, moment, monkeypatch):
    monkeypatch.setattr(at.Renderer, "render", None)
    for plans, words in (
        ([], "two plans or more"),
        (PLANS[:1], "two plans or more"),
        (["single+bsah", "bsah+wide", parse_plan("bsah+single")], "'bsah\\+single' is named twice"),
        (["bsah+single", "nothing+wide"], "nothing"),
    ):
        with pytest.raises(at.InputError, match=words):
            compare(scene, moment, plans)
    with pytest.raises(at.InputError, match="is ray-guided"):
        at.Plan(trace="wide", sample=at.SrdhRays(2))
    with pytest.raises(at.InputError, match="rounds"):
        compare(scene, moment, PLANS[:2], rounds=0)
