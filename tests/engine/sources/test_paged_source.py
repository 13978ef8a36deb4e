"""Scenes in a store give the pictures of scenes in memory, for any budget. Errors in a store are reported."""

import gc
import json
import os
import subprocess
import sys
import threading
import weakref

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.sources import paged_source
from antumbra.engine.sources.paged_source import Bands
from antumbra.engine.store_building import build_store
from antumbra.picture import frame_passes
from antumbra.picture.frame_request import TimeSample
from antumbra.picture.renderer import Renderer
from antumbra.picture.traversal_steps import explain
from antumbra.store import system_resources
from antumbra.store.chunk_residency import POLICIES, Residency

SIZE = 72, 60
LIGHT = at.QuadLight((-30, 60, -20), (30, 0, 0), (0, 0, 30))


@pytest.fixture(scope="module")
def city(tmp_path_factory):
    """(scene in memory, path of its store). The store has 40 chunks or more."""
    scene, path = at.procedural("city", triangles=20_000), tmp_path_factory.mktemp("paged") / "city.antumbra"
    assert build_store([scene], path, chunk=512).chunks >= 40
    return scene, path


def _cameras(scene, n=3):
    far = scene.cameras[0].resized(*SIZE)
    street = [
        at.Camera((7, 1.7, 30 - 4 * k), (7, 3, -60 + 20 * k), width=SIZE[0], height=SIZE[1]) for k in range(n - 1)
    ]
    return [far, *street]


def _renderer(path, chunks=None, policy="lru"):
    """A renderer with a budget of `chunks` of the largest chunks; None: 4 GiB."""
    renderer = Renderer(at.load(path), None, 2)
    if chunks is not None:
        paged = renderer.source
        paged.residency = Residency(paged.store, paged.residency.min_budget() // 2 * chunks, policy)
        scheduled = paged.accelerated.prepared
        scheduled.parts = scheduled.parts._replace(trees=paged.residency.trees, memory=paged.residency)
        paged.budget = lambda *_: paged.residency.budget
    return renderer


def _same(frame, other):
    assert len(frame.bits) == len(other.bits)
    for name in ("position", "normal", "face", "depth", "side"):
        np.testing.assert_array_equal(getattr(frame.gbuffer, name), getattr(other.gbuffer, name))
    for a, b in zip(frame.bits, other.bits):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_array_equal(frame.image, other.image)


@pytest.mark.parametrize("policy", POLICIES)
@pytest.mark.parametrize("chunks", [None, 2, 9])
def test_pictures_are_those_in_memory(city, chunks, policy):
    scene, path = city
    lights = [LIGHT, at.DirectionalLight((0.4, -1, 0.3)), at.AmbientOcclusion(3.0)]
    renderer, inside = _renderer(path, chunks, policy), Renderer(scene, "bsah+single", 2)
    loaded = 0
    for camera in [*_cameras(scene), _cameras(scene)[0]]:
        frame = renderer.render(camera, lights, spp=4)
        _same(frame, inside.render(camera, lights, spp=4))
        paging = frame.paging
        loaded += paging["loaded"]
        assert paging["wanted"] >= paging["cached"] + paging["loaded"] > 0
        if chunks is not None:
            assert renderer.source.residency.used <= renderer.source.residency.budget
    assert (loaded > 2 * len(renderer.source.store)) == (chunks is not None)


def test_bands_of_a_picture_too_large_for_memory(city, monkeypatch):
    """The bands are different in each frame. Their pictures are not."""
    scene, path = city
    lights = [LIGHT, at.DirectionalLight((0.4, -1, 0.3))]
    camera, options = scene.cameras[0].resized(40, 300), {"spp": 4, "adaptive": 16, "bounce": 1, "filter": True}
    inside = Renderer(scene, "bsah+single", 2).render(camera, lights, **options)
    renderer, cuts = _renderer(path, 3), []
    of_frame = Bands.of_frame

    def noted(self, height, exceeds):
        cuts.append([])
        for rows in of_frame(self, height, exceeds):
            cuts[-1].append(rows)
            yield rows

    monkeypatch.setattr(Bands, "of_frame", noted)
    for _ in range(3):
        frame = renderer.render(camera, lights, **options)
        _same(frame, inside)
        assert frame.rays == inside.rays
        np.testing.assert_array_equal(frame.indirect, inside.indirect)
    assert len(cuts[0]) > 1  # later frames may pause bands
    assert all(max(band.stop for band in rows) == 300 for rows in cuts)
    renderer.source.residency.close()


def test_queries_of_earlier_bands_are_freed(city, monkeypatch):
    """They would take more memory than the surfaces and the bits of these bands, which is all that counts as theirs."""
    scene, path = city
    renderer, begun, trace = _renderer(path, 3), list[weakref.ref](), frame_passes.trace

    def noted(*arguments):
        assert all(each() is None for each in begun[:-1])  # the last one's are still in use
        traced = trace(*arguments)
        begun.append(weakref.ref(traced[0].query.origins))
        return traced

    monkeypatch.setattr(frame_passes, "trace", noted)
    renderer.render(scene.cameras[0].resized(24, 200), [LIGHT])
    assert len(begun) > 2
    renderer.source.residency.close()


@pytest.mark.parametrize("normals", [None, (0.0, 1.0, 0.0)])
@pytest.mark.parametrize("light", [LIGHT, at.DirectionalLight((0.4, -1, 0.3)), at.AmbientOcclusion(30.0)], ids=repr)
def test_points_see_lights_as_they_do_in_memory(city, light, normals):
    """Chunks that one query reads stay in memory for the next one."""
    inside, path = city
    scene, points = at.load(path), np.random.default_rng(3).uniform((-40, 0.2, -40), (40, 12, 40), (900, 3))
    if normals is None and light.domain == "hemisphere":
        with pytest.raises(at.InputError, match="normal"):
            at.visibility(scene, points, light)
        return
    truth = at.visibility(inside, points, light, normals, spp=20)
    assert 0.05 < truth.fraction.mean() < 0.95
    for _ in range(2):
        got = at.visibility(scene, points, light, normals, spp=20, threads=2)
        np.testing.assert_array_equal(got.bits, truth.bits)
    paging = scene.engine.source.paging()
    assert paging["loaded"] == 0 and paging["cached"] > 0


def test_points_that_ask_a_store_within_little_memory(city):
    with pytest.raises(at.InputError, match=r"not enough.* give at least \d+M"):
        at.visibility(at.load(city[1]), np.zeros((1, 3)), LIGHT, max_memory=1 << 20)
    with pytest.raises(at.InputError, match="is in memory; leave it out"):
        at.visibility(city[0], np.zeros((1, 3)), LIGHT, max_memory=1 << 30)


def test_light_that_bounces(city):
    scene, path = city
    camera = _cameras(scene)[1].resized(32, 24)
    frame, other = (at.render(s, camera, LIGHT, spp=2, bounce=2, threads=2) for s in (at.load(path), scene))
    _same(frame, other)
    np.testing.assert_array_equal(frame.indirect, other.indirect)
    assert frame.indirect.any()


def _rays(scene, n=4000):
    """Rays of all kinds: with ends, with faces to skip, towards nothing."""
    rng = np.random.default_rng(4)
    low, high = scene.bounds
    origins = rng.uniform(low, high, (n, 3))
    directions = rng.normal(size=(n, 3)) * 10.0 ** rng.uniform(-2, 2, (n, 1))
    span = np.linalg.norm(high - low) / np.linalg.norm(directions, axis=1)
    tmin, tmax = rng.choice([0.0, 0.0, 0.02], n) * span, np.where(rng.random(n) < 0.5, np.inf, 0.1 * span)
    return origins, directions, tmin, tmax, rng.integers(-1, scene.n_triangles, n)


@pytest.mark.parametrize("facing", [None, "front", "back"])
def test_rays_meet_what_they_meet_in_memory(city, facing):
    inside, path = city
    scene, rays = at.load(path), _rays(inside)
    truth, blocked = (ask(*rays, cull_faces=facing) for ask in (inside.closest_hit, inside.occluded))
    assert 0.2 < blocked.mean() < 0.9
    for _ in range(2):
        hit = scene.closest_hit(*rays, cull_faces=facing, threads=2)
        for name in ("face", "t", "u", "v"):
            np.testing.assert_array_equal(getattr(hit, name), getattr(truth, name))
        np.testing.assert_array_equal(scene.occluded(*rays, cull_faces=facing, threads=2), blocked)


def test_rays_in_batches_and_shapes(city, monkeypatch):
    inside, path = city
    scene, (origins, directions, *_) = at.load(path), _rays(inside, 1200)
    monkeypatch.setattr("antumbra.engine.sources.paged_source.MIN_BATCH", 100)
    monkeypatch.setattr("antumbra.engine.sources.paged_source.Paged.together", lambda self, size: 1)
    truth = inside.closest_hit(origins, directions)
    hit = scene.closest_hit(origins.reshape(30, 40, 3), directions.reshape(30, 40, 3))
    np.testing.assert_array_equal(hit.face, truth.face.reshape(30, 40))
    np.testing.assert_array_equal(hit.u, truth.u.reshape(30, 40))
    assert scene.occluded(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0,)
    assert scene.occluded(origins[0], directions[0]) == inside.occluded(origins[0], directions[0])
    with pytest.raises(at.InputError, match=r"direction of ray 3 is zero"):
        scene.occluded(origins[:9], np.where(np.arange(9)[:, None] == 3, 0.0, directions[:9]))


def test_adaptive_sampling(city):
    scene, path = city
    camera = _cameras(scene)[1]
    frame, other = (at.render(s, camera, LIGHT, spp=4, adaptive=16, threads=2) for s in (at.load(path), scene))
    _same(frame, other)
    np.testing.assert_array_equal(frame.refined, other.refined)
    assert 0.02 < frame.refined.mean() < 0.9


def test_virtual_point_lights(city):
    scene, path = city
    light = at.DirectionalLight((0.4, -1, 0.3))
    one, other = (at.virtual_point_lights(s, light, 200, threads=2) for s in (at.load(path), scene))
    for name in ("positions", "colours", "normals"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    assert one.intensity == other.intensity and len(one.positions) > 50


def test_an_explanation_is_of_the_stores_own_tree(city):
    scene, path = city
    moments = [TimeSample(0.0, _cameras(scene)[1], [LIGHT, at.AmbientOcclusion(3.0)])]
    one, other = (explain(s, moments, ["bsah+chcrt"], spp=4, threads=2) for s in (at.load(path), scene))
    for name in ("rays", "blocked"):
        assert getattr(one, name) == getattr(other, name) > 0
    np.testing.assert_array_equal(one.asks, other.asks)
    a, b = one.plans[0], other.plans[0]
    assert 0.2 < a.box_tests / b.box_tests < 5 and 0 < a.depths.deepest < 40
    assert a.depths.histogram.sum() == b.depths.histogram.sum() == one.blocked
    assert 0 < len(one.frequent) < 2 * len(other.frequent) and one.frequent.max() > 5000
    with pytest.raises(at.InputError, match=r"is in a store, whose trees are prebuilt; use bsah\+chcrt"):
        explain(at.load(path), moments, ["bsah+single"])
    small = at.load(path)
    small.max_memory = 1 << 20
    with pytest.raises(at.InputError, match=r"1M of memory is not enough"):
        explain(small, moments, ["bsah+chcrt"])


def test_threads_share_chunks(city):
    """Two threads ask one scene in turns: answers are those of one thread, and no chunk is read twice."""
    _, path = city
    scene, found, turn = at.load(path), {}, threading.Barrier(2)
    points = np.random.default_rng(3).uniform((-40, 0.2, -40), (40, 12, 40), (300, 3))

    def work(k):
        for _ in range(3):
            turn.wait()
            found.setdefault(k, []).append(at.visibility(scene, points + k, LIGHT, spp=4).bits)

    threads = [threading.Thread(target=work, args=(k,)) for k in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    alone = at.load(path)
    for k in range(2):
        bits = at.visibility(alone, points + k, LIGHT, spp=4).bits
        assert len(found[k]) == 3 and all((bits == each).all() for each in found[k])
    assert scene.engine.source.residency.paging.loaded == alone.engine.source.residency.paging.loaded > 0


def test_a_limit_on_memory_counts_from_the_next_question_on(city):
    scene = at.load(city[1])
    assert scene.occluded((0, 500, 0), (0, -1, 0))
    scene.max_memory = 1 << 20
    with pytest.raises(at.InputError, match="1M of memory is not enough"):
        scene.occluded((0, 500, 0), (0, -1, 0))


def test_what_a_process_holds_already_refuses_no_store(city, monkeypatch):
    """The arrays of a notebook may take more than the default limit, and grow while a store is open."""
    scene, camera = at.load(city[1]), _cameras(city[0])[1].resized(32, 24)
    truth = at.render(city[0], camera, LIGHT, spp=2)
    for held in (0, 5 << 30, 40 << 30):
        for module in (system_resources, paged_source):
            monkeypatch.setattr(module, "resident_memory", lambda held=held: (1 << 28) + held)
        assert scene.occluded((0, 500, 0), (0, -1, 0))
        _same(at.render(scene, camera, LIGHT, spp=2), truth)
        assert scene.data.fits(1)
    with pytest.raises(at.InputError, match="1024M of memory is not enough"):
        at.render(scene, camera, LIGHT, spp=2, max_memory=1 << 30)


def test_old_questions_are_forgotten(city):
    _, path = city
    scene, light, fronts = at.load(path), at.SphereLight((0, 30, 0), 1.0), []
    for n in range(10, 60):
        at.visibility(scene, np.full((n, 3), 5.0), light, spp=1)
        fronts += [weakref.ref(each) for _, each in scene.engine.source.accelerated.prepared.states()]
    gc.collect()
    assert len(fronts) == 50 and sum(front() is not None for front in fronts) < 12


def test_damage_after_a_chunk_was_read(city, tmp_path):
    """A chunk that is read again is checked again."""
    scene, path = city
    copy = tmp_path / "damaged.antumbra"
    copy.write_bytes(path.read_bytes())
    renderer, camera = _renderer(copy, 2), _cameras(scene)[0]
    renderer.render(camera, LIGHT, spp=1)
    chunks = renderer.source.store.chunks
    with copy.open("r+b") as stream:
        for offset in chunks.offset:
            stream.seek(int(offset) + 700)
            stream.write(b"\x55\x55\x55\x55")
    with pytest.raises(at.InputError, match=r"damaged\.antumbra: chunk \d+ of \d+ .* is damaged"):
        renderer.render(camera, LIGHT, spp=1)
    with copy.open("r+b") as stream:
        stream.truncate(5000)
    with pytest.raises(at.InputError, match=r"chunk \d+ of \d+ .* is cut short"):
        renderer.render(camera, LIGHT, spp=1)


def test_a_camera_that_sees_nothing(city):
    _, path = city
    camera = at.Camera((0, 900, 0), (0, 1000, 1), width=20, height=16)
    frame = at.render(at.load(path), camera, LIGHT, threads=2)
    assert (frame.gbuffer.face == -1).all() and not frame.image.any()


def test_two_renderers_share_a_store(city):
    """Two renderers work in two threads at the same time."""
    scene, path = city
    cameras, found = _cameras(scene, 2), {}

    def work(k):
        found[k] = [_renderer(path, 3).render(camera, LIGHT, spp=4) for camera in cameras[:: 1 if k else -1]]

    threads = [threading.Thread(target=work, args=(k,)) for k in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for one, other in zip(found[0], reversed(found[1])):
        _same(one, other)


def test_damage_is_named_when_it_is_met(city, tmp_path):
    scene, path = city
    copy = tmp_path / "damaged.antumbra"
    data = bytearray(path.read_bytes())
    store = at.load(path).store
    for k in range(len(store)):
        data[int(store.chunks.offset[k]) + 700] ^= 1
    copy.write_bytes(data)
    renderer = Renderer(at.load(copy), None, 2)
    with pytest.raises(at.InputError, match=r"damaged\.antumbra: chunk \d+ of \d+ .* is damaged"):
        renderer.render(_cameras(scene)[0], LIGHT, spp=1)


def test_what_cannot_be_asked_of_a_store(city):
    scene, path = city
    paged, camera = at.load(path), _cameras(scene)[0]
    for plan in ("bsah+single", "lbvh+chcrt", "grid32+bsah+chcrt", "bsah+refit+chcrt", "cones"):
        with pytest.raises(at.InputError, match=r"is in a store, whose trees are prebuilt; use bsah\+chcrt"):
            Renderer(paged, plan)
    with pytest.raises(at.InputError, match=r"100M of memory is not enough .* give at least \d+M"):
        at.render(paged, camera, LIGHT, max_memory=100 << 20)
    with pytest.raises(at.InputError, match="max_memory is for scenes in a store"):
        at.render(scene, camera, LIGHT, max_memory=1 << 30)
    with pytest.raises(at.InputError, match="eviction policy is 'mru'; choose lru or round-robin"):
        Residency(paged.store, 1 << 30, "mru")


_RENDER = """
import json, sys
import antumbra as at
from antumbra.store.system_resources import peak_resident_memory
from antumbra.picture.renderer import Renderer
path, memory = sys.argv[1], int(sys.argv[2])
scene = at.load(path)
renderer = Renderer(scene, None, 2, max_memory=memory)
camera = scene.cameras[0].resized(256, 256)
frames = [renderer.render(camera, scene.lights, spp=4) for _ in range(2)]
print(json.dumps({"peak": peak_resident_memory(), "loaded": [f.paging["loaded"] for f in frames]}))
"""


@pytest.mark.slow
def test_five_million_triangles_in_a_tenth_of_their_size(tmp_path):
    """The process keeps to its memory budget, measured as its resident set."""
    path = tmp_path / "city.antumbra"
    command = [sys.executable, "-m", "antumbra", "build", "procedural:city?triangles=5M", "-o", str(path), "-q"]
    subprocess.run([*command, "--max-memory", "1G"], check=True)
    tenth = path.stat().st_size // 10
    scene = at.load(path)
    camera, lights = scene.cameras[0].resized(256, 256), scene.lights
    renderer = _renderer(path, 0)
    renderer.source.residency.budget = max(tenth, renderer.source.residency.min_budget())
    assert renderer.source.residency.budget == tenth
    whole = at.procedural("city", triangles=5_000_000)
    expected = at.render(whole, camera, lights, spp=4, threads=2)
    for _ in range(2):
        _same(renderer.render(camera, lights, spp=4), expected)
        assert renderer.source.residency.used <= tenth
    del whole, expected
    memory = 640 << 20
    process = subprocess.run([sys.executable, "-c", _RENDER, str(path), str(memory)], capture_output=True, check=True)
    answer = json.loads(process.stdout.splitlines()[-1])
    assert answer["peak"] <= memory and answer["loaded"][0] > 0
    assert os.path.getsize(path) > 200_000_000


def test_an_interruption_while_chunks_are_read_leaves_the_renderer_as_it_was(city):
    scene, path = city
    renderer, camera = _renderer(path, 9), _cameras(scene)[0]
    residency = renderer.source.residency

    def interrupt(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        renderer.render(camera, LIGHT, spp=2, progress=interrupt)
    assert residency.used <= residency.budget and residency.pending == 0
    _same(renderer.render(camera, LIGHT, spp=2), at.render(scene, camera, LIGHT, spp=2, threads=2))
