"""The benchmark of CHC+RT: its walks, its comparisons, and the figures derived from them."""

import numpy as np
import pytest

from antumbra.base.errors import InputError
from antumbra.engine.scene import procedural
from antumbra.engine.scene_loading import load
from antumbra.engine.store_building import build_store
from antumbra.lab.papers.benchmark_views import scene_view
from antumbra.lab.papers.chc_rt import chcrt_published, store_walkthroughs, walkthrough_timing
from antumbra.lab.papers.chc_rt.store_walkthroughs import StoreCase
from antumbra.lab.papers.chc_rt.walkthrough_timing import CHCRT, InCore, Pace, Turn
from antumbra.lab.papers.chc_rt.walkthroughs import DIFFUSE, PRIMARY, SOFT, differing, place_of
from antumbra.scene.camera import Camera
from antumbra.techniques.tracer_options import ChcRtOptions

SIZE = 24
AGGRESSIVE = "chcrt", "chcrt:20", "chcrt:100", "chcrt:200"


@pytest.fixture(scope="module")
def core():
    view = scene_view("city", procedural("city", triangles=120_000), (SIZE, SIZE))
    return InCore(place_of(view), 2, ChcRtOptions(triangles=1 << 12))


def test_walks_go_from_one_camera_to_the_other(core):
    near, far = core.place.walks
    assert (near.name, far.name) == ("near", "far")
    for walk in (near, far):
        assert (walk.camera(0, 5).position == walk.first.position).all()
        assert (walk.camera(4, 5).target == walk.last.target).all()
        middle = (walk.first.position + walk.last.position) / 2
        np.testing.assert_allclose(walk.camera(2, 5).position, middle)
        assert (walk.camera(0, 1).position == walk.first.position).all()
    low, high = core.place.scene.bounds
    assert (near.first.position < high).all() and (near.first.position > low).all()
    assert far.first.position[1] > high[1]


def test_a_place_has_the_same_walks_in_images_of_another_size(core):
    small = core.place.resized(12, 8)
    for one, other in zip(core.place.walks, small.walks, strict=True):
        for a, b in ((one.first, other.first), (one.last, other.last)):
            assert (b.width, b.height) == (12, 8) and (a.width, a.height) == (SIZE, SIZE)
            assert (a.position == b.position).all() and (a.target == b.target).all() and a.vfov == b.vfov


def test_an_own_camera_walks_ahead():
    view = scene_view("cellar", procedural("cellar", triangles=2000), (SIZE, SIZE))
    near = place_of(view).walks[0]
    ahead = near.last.position - near.first.position
    assert np.dot(ahead, near.first.target - near.first.position) > 0.0
    assert near.first.position.tolist() == view.camera.position.tolist()


def test_methods_have_their_turns_and_agree(core):
    near = core.place.walks[0]
    methods = [core.culling(), *core.plain()]
    turns = walkthrough_timing.walk_through(
        core, near, methods, (PRIMARY, DIFFUSE, SOFT), "halton:36", Pace(4, 1, 60.0), lambda text: None
    )
    assert [t.frame for t in walkthrough_timing.of(turns, method=CHCRT, kind=SOFT)] == [0, 1, 2, 3]
    hits = ["single", "multifrusta"]
    for kind, plans in ((PRIMARY, hits), (DIFFUSE, hits), (SOFT, [m.name for m in methods[1:]])):
        others = [t for t in walkthrough_timing.of(turns, kind=kind) if t.method != CHCRT]
        assert [(t.method, t.frame) for t in others] == [(plan, 1) for plan in plans]
    assert all(t.differs == 0 and t.rays > 0 for t in turns)


def test_what_differs_is_counted():
    bits = np.array([[[5]]], np.uint64)
    assert differing([(bits,)], [(bits ^ np.uint64(6),)]) == 2
    face, t = np.array([1, -1, 3]), np.array([1.0, np.inf, 2.0])
    other = np.array([1, -1, 4]), np.array([1.5, np.inf, 2.0])
    assert differing([(face, t)], [other]) == 2 and differing([(face, t)] * 2, [(face, t)] * 2) == 0


def test_a_walk_ends_at_its_limit(core):
    near = core.place.walks[0]
    turns = walkthrough_timing.walk_through(
        core, near, [core.culling()], (PRIMARY,), "halton:36", Pace(50, 1, 0.0), lambda text: None
    )
    assert [t.frame for t in turns] == [0, 1]


def test_pictures_of_neglected_rays_are_compared(core):
    far = core.place.walks[1]
    methods = [core.culling(), core.culling(200)]
    turns = walkthrough_timing.walk_through(
        core, far, methods, (DIFFUSE,), "halton:36", Pace(2, 1, 60.0), lambda text: None
    )
    exact, other = (walkthrough_timing.of(turns, method=m.name) for m in methods)
    assert all(t.error is None and t.differs == 0 for t in exact)
    assert all(0.0 < t.error <= 255.0 and t.differs > 0 for t in other)


def test_pictures_of_neglected_rays_of_a_store_are_compared(core, tmp_path):
    path = tmp_path / "city.antumbra"
    build_store([core.place.scene], path, chunk=1 << 9)
    case, pace = StoreCase(core.place._replace(scene=load(path)), 2), Pace(2, 1, 60.0)
    walks = store_walkthroughs.aggressive_out_of_core(lambda: case, pace, lambda text: None)
    turns = [t for _, measure in walks for t in measure().turns]
    for walk in case.place.walks:
        exact, *others = ([t for t in turns if (t.view, t.method) == (walk.name, name)] for name in AGGRESSIVE)
        assert [t.frame for t in exact] == [0, 1] and all(t.error is None and t.statistics["wanted"] > 0 for t in exact)
        assert all([t.frame for t in other] == [0, 1] and t.error is not None for other in others for t in other)
    lost = {name: sum(t.error for t in turns if t.method == name) for name in AGGRESSIVE[1:]}
    assert 0.0 < lost["chcrt:200"] <= 4 * 255.0 and lost["chcrt:20"] <= lost["chcrt:200"]


def test_cameras_that_see_nothing_are_refused(core):
    away = Camera((1e4, 1e4, 1e4), (2e4, 2e4, 2e4), width=SIZE, height=SIZE)
    walk = core.place.walks[0]._replace(first=away, last=away)
    with pytest.raises(InputError, match="city: the near camera sees nothing"):
        walkthrough_timing.walk_through(
            core, walk, [core.culling()], (PRIMARY,), "halton:36", Pace(2, 1, 1.0), lambda text: None
        )


def made(method, frame, seconds, told=None):
    return Turn("city", "near", "halton:36", PRIMARY, method, frame, 100, seconds, told or {}, 0)


def test_medians_leave_out_the_first_frame():
    phases = dict.fromkeys(walkthrough_timing.PHASES, 0.25)
    ours = [made(CHCRT, k, s, {**phases, "queries": 10 * k}) for k, s in enumerate((9.0, 1.0, 2.0, 4.0))]
    theirs = [made("single", k, s) for k, s in ((1, 4.0), (3, 6.0))]
    assert walkthrough_timing.first(ours) == 9.0 and walkthrough_timing.first(theirs) is None
    assert (
        walkthrough_timing.typical(ours) == 2.0
        and walkthrough_timing.typical(ours, "queries") == 20
        and walkthrough_timing.typical(ours, "bytes") == 0
    )
    assert walkthrough_timing.typical(ours, "before") == 1.25
    assert walkthrough_timing.speedup(ours, theirs) == 2.0  # in frames 1 and 3
    assert walkthrough_timing.typical(ours[:1]) == 9.0
    assert walkthrough_timing.rows_of([*ours, *theirs], "method") == [{"method": CHCRT}, {"method": "single"}]


def test_speedups_are_of_the_same_kind():
    turns = [made(m, k, s)._replace(kind=kind) for kind, m, k, s in (
        (PRIMARY, CHCRT, 0, 9.0), (PRIMARY, CHCRT, 1, 2.0), (PRIMARY, "single", 1, 3.0),
        (SOFT, CHCRT, 1, 1.0), (SOFT, "single", 1, 4.0), (SOFT, "packet16", 1, 9.0),
    )]  # fmt: skip
    turns += [t._replace(view="far", seconds=2 * t.seconds if t.method == CHCRT else t.seconds) for t in turns]
    assert walkthrough_timing.speedups(turns) == {PRIMARY: [1.5, 0.75], SOFT: [4.0, 2.0]}
    assert walkthrough_timing.speedups(turns, "packet16") == {PRIMARY: [], SOFT: [9.0, 4.5]}
    assert walkthrough_timing.speedups([t for t in turns if t.method == CHCRT]) == {PRIMARY: [], SOFT: []}
    assert [len(chcrt_published.speedups(k)) for k in range(3)] == [6, 6, 6]
    assert max(chcrt_published.speedups(0)) == pytest.approx(5.5) and min(chcrt_published.speedups(2)) < 0.9
    assert chcrt_published.moved(2)[:3] == [383 / 7890, 1.73 / 7890, 0.55 / 11400]


@pytest.mark.parametrize("size, tile", [((640, 360), 128), ((320, 200), 64), ((192, 108), 32)])
def test_there_are_pairs_to_query(size, tile):
    place = place_of(scene_view("city", procedural("city", triangles=1000), size))
    options = walkthrough_timing.options_of(place)
    assert options.tile == tile and -(-size[0] // tile) * -(-size[1] // tile) >= 8
    assert place.scene.n_triangles // options.triangles >= 16 and options.weight == ChcRtOptions().weight


def test_the_papers_best_is_in_its_table():
    ratios = [
        glsl / ours
        for methods in chcrt_published.TIMES.values()
        for near_far in zip(methods["GLSL"], methods["CHC+RT"])
        for glsl, ours in zip(*near_far)
    ]
    assert max(ratios) == pytest.approx(chcrt_published.BEST, abs=0.03)
