"""One engine answers all questions about a scene: it owns its state, and threads of Python may share it."""

import ast
import gc
import pickle
import threading
import weakref
from pathlib import Path

import numpy as np
import pytest

import antumbra
import antumbra as at
from repository import ROOT
from stores import built

LAMP = at.QuadLight((-1, 7, -1), (2, 0, 0), (0, 0, 2))
SOURCE = Path(antumbra.__file__).parent


@pytest.fixture(scope="module")
def atrium():
    return at.procedural("atrium", triangles=3000)


@pytest.fixture(scope="module")
def both(atrium, tmp_path_factory):
    """The scene in memory, and in a store."""
    return atrium, at.load(built(tmp_path_factory.mktemp("engine"), atrium).path)


def _rays(n=300, seed=2):
    rng = np.random.default_rng(seed)
    return rng.uniform((-6, 0.1, -4), (6, 5, 4), (n, 3)), rng.normal(size=(n, 3))


def test_faces_and_engines_give_the_same_answers(both):
    rays = _rays()
    points, camera = rays[0], both[0].cameras[0].resized(24, 20)
    blocked, hits, seen = [], [], []
    for scene in both:
        engine = at.Engine(scene)
        frame = at.render(scene, camera, [LAMP], spp=1)
        surfaces = engine.surfaces(camera)
        np.testing.assert_array_equal(surfaces.face, frame.gbuffer.face)
        np.testing.assert_array_equal(surfaces.depth, frame.gbuffer.depth)
        blocked += [scene.occluded(*rays), engine.occluded(*rays)]
        hits += [scene.closest_hit(*rays), engine.closest_hit(*rays)]
        receivers = at.Receivers.in_space(points, scene.origin)
        seen += [at.visibility(scene, points, [LAMP]), engine.visibility(receivers, [LAMP])]
    for one in blocked[1:]:
        np.testing.assert_array_equal(one, blocked[0])
    for one in hits[1:]:
        assert all((a == b).all() for a, b in zip(one, hits[0]))
    for one in seen[1:]:
        np.testing.assert_array_equal(one.bits, seen[0].bits)
    assert 0 < blocked[0].mean() < 1 and 0 < seen[0].fraction.mean() < 1


def test_receivers_are_those_of_points_with_normals(atrium):
    points, normals = _rays()
    receivers = at.Receivers.on_surface(points, normals, atrium.origin, atrium.middle)
    found = atrium.engine.visibility(receivers, [LAMP, at.AmbientOcclusion()], spp=8)
    expected = at.visibility(atrium, points, [LAMP, at.AmbientOcclusion()], normals, spp=8)
    np.testing.assert_array_equal(found.bits, expected.bits)
    some = atrium.engine.visibility(receivers.take(slice(64, 128)), [LAMP], spp=8)
    np.testing.assert_array_equal(some.fraction[:, 0], expected.fraction[64:128, 0])


@pytest.mark.parametrize("plan", [None, "bsah+single", "grid32+bsah+single", "srdh+single", "cones"])
def test_threads_share_an_engine(both, plan):
    """Eight threads ask different questions at once, while trees are made: each gets its own answer."""
    for scene in both if plan is None else both[:1]:
        engine = at.Engine(scene, plan)
        asked = [_rays(200, seed) for seed in range(8)]
        found, wait = {}, threading.Barrier(len(asked))

        def work(k, scene=scene, engine=engine, asked=asked, found=found, wait=wait):
            wait.wait()
            receivers = at.Receivers.in_space(asked[k][0], scene.origin)
            for _ in range(3):
                answer = engine.occluded(*asked[k]), engine.visibility(receivers, [LAMP], spp=4).bits
                found.setdefault(k, []).append(answer)

        threads = [threading.Thread(target=work, args=(k,)) for k in range(len(asked))]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        for k, rays in enumerate(asked):
            blocked = both[0].occluded(*rays)
            bits = at.visibility(both[0], rays[0], [LAMP], spp=4, plan="bsah+single").bits
            assert len(found[k]) == 3
            for mine, seen in found[k]:
                np.testing.assert_array_equal(mine, blocked)
                np.testing.assert_array_equal(seen, bits)


def test_engines_of_other_plans_share_trees_and_are_remembered(atrium):
    engine = at.Engine(atrium)
    one, other = (engine.with_options(plan, 1, None) for plan in ("bsah+single", "bsah+multifrusta"))
    assert one.accelerated().bvh is other.accelerated().bvh
    assert engine.with_options("bsah+single", 1, None) is one
    assert engine.with_options(None, None, None) is engine
    assert engine.with_options(engine.plan, engine.threads, None) is engine
    engines = [engine.with_options("bsah+single", threads, None) for threads in range(1, 20)]
    assert [engine.with_options("bsah+single", threads, None) for threads in range(12, 20)] == engines[11:]
    assert engine.with_options("bsah+single", 1, None) is not one  # only the latest eight are remembered


def test_of_a_store_only_the_engine_asked_last_keeps_chunks(both):
    """Chunks that others keep would count against the limit on memory."""
    scene, points = both[1], _rays(50)[0]
    engine = at.Engine(scene)
    own = engine.source.residency
    receivers = at.Receivers.in_space(points, scene.origin)
    first = engine.visibility(receivers, [LAMP], spp=4)
    assert own.held > 0
    other = engine.with_options(None, engine.threads + 1, None)
    np.testing.assert_array_equal(other.visibility(receivers, [LAMP], spp=4).bits, first.bits)
    assert own.held == 0 < other.source.residency.held
    third = engine.with_options(None, engine.threads + 2, None)
    assert third is not other and engine.with_options(None, engine.threads + 2, None) is third
    assert engine.with_options(None, None, None) is engine
    others = [weakref.ref(other), weakref.ref(third)]
    del other, third
    gc.collect()
    assert [each() for each in others] == [None, None]
    engine.occluded(*_rays(50), threads=engine.threads + 1)
    engine.occluded(*_rays(50))
    assert own.held > 0


def test_a_scene_that_nobody_has_leaves_memory_at_once():
    """No circle of references waits for a collection."""
    scene = at.procedural("atrium", triangles=1000)
    scene.occluded(*_rays(10))
    at.visibility(scene, _rays(10)[0], LAMP)
    at.visibility(scene, _rays(10)[0], LAMP, plan="bsah+single", threads=1)
    data = weakref.ref(scene.data)
    gc.disable()
    try:
        del scene
        assert data() is None
    finally:
        gc.enable()


def test_pickles_have_no_engine(both):
    rays = _rays(50)
    for scene in both:
        before = scene.occluded(*rays)
        again = pickle.loads(pickle.dumps(scene))
        size = len(pickle.dumps(again))
        assert repr(again) == repr(scene)
        np.testing.assert_array_equal(again.occluded(*rays), before)
        assert len(pickle.dumps(again)) == size


def test_attributes_of_data_are_those_of_the_face():
    scene = at.procedural("atrium", triangles=1000)
    assert scene.name == scene.data.name and scene.n_triangles == scene.data.n_triangles > 0
    scene.up = "z"
    assert scene.data.up == "z"


@pytest.mark.parametrize(
    "arguments, words",
    [
        (("nothing",), "nothing"),
        ((None, 0), "threads"),
        ((None, None, 1 << 30), "max_memory is for scenes in a store"),
        ((7,), "plan"),
    ],
)
def test_wrong_arguments_are_refused(atrium, arguments, words):
    with pytest.raises(at.InputError, match=words):
        at.Engine(atrium, *arguments)
    with pytest.raises(at.InputError):
        at.Engine("no such file.glb")


def test_nobody_reaches_into_the_state_of_others():
    """State has one owner: no module reads the `__dict__` of another object."""
    for path in SOURCE.rglob("*.py"):
        if "kernels" in path.parts or path.name == "fielddocs.py":
            continue
        text = path.read_text()
        for node in ast.walk(ast.parse(text)) if "__dict__" in text else ():
            if isinstance(node, ast.Attribute) and node.attr == "__dict__":
                assert isinstance(node.value, ast.Name) and node.value.id == "self", f"{path}:{node.lineno}"


def test_from_a_scene_to_the_kernel_are_five_places():
    """CONTRIBUTING.md lists them; each exists, and its floor is that of the one before or a lower one."""
    text = (ROOT / "CONTRIBUTING.md").read_text()
    part = text[text.index("A ray query reaches") : text.index("A call of `antumbra.render` reaches")]
    lines = [line for line in part.splitlines() if line[:1].isdigit()]
    floors = ["engine", "trace"]
    assert len(lines) == 5
    before, place = 0, None
    for line in lines:
        name, file = line.split("`")[1], line.split("`")[3] if line.count("`") > 3 else place
        place = file
        source = (SOURCE / place).read_text()
        assert f"def {name.split('.')[-1]}(" in source and before <= floors.index(place.split("/")[0])
        before = floors.index(place.split("/")[0])


def test_hits_keep_the_triangles_of_their_moment(tmp_path):
    """A question about another moment changes no hit from before, and needs no new tree for it."""
    still = np.array([[0, 0, 0], [4, 0, 0], [0, 0, 4]], float)
    np.save(tmp_path / "frames.npy", np.stack([still, still + (0, 3, 0)]))
    np.save(tmp_path / "faces.npy", np.arange(3)[None])
    scene = at.load(tmp_path)
    first = scene.closest_hit((1, 9, 1), (0, -1, 0), time=0.0)
    later = scene.closest_hit((1, 9, 1), (0, -1, 0), time=scene.duration)
    tree = scene.engine.accelerated(scene.duration)
    assert first.position.tolist() == [1, 0, 1] and later.position.tolist() == [1, 3, 1]
    assert scene.engine.accelerated(scene.duration) is tree
