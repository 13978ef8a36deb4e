"""Of faces at the same t, the one whose front faces the ray's origin wins, then the lowest: on every way to a hit."""

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
import oracle
from antumbra.bvh import binned_sah
from antumbra.bvh.block_tree import block_tree
from antumbra.engine.method_registry import BUILDERS
from antumbra.engine.store_building import build_store
from antumbra.lab.papers.multi_frusta.moeller_trumbore import deep_tree, trace_packets
from antumbra.lab.papers.multi_frusta.primary_frusta import trace_frusta
from antumbra.lab.papers.multi_frusta.published_frusta import BLOCK
from antumbra.picture.renderer import Renderer
from antumbra.query.rasteriser import rasterise
from antumbra.query.ray_passes import RayPass, rays_through
from antumbra.scene.alpha_masks import cutouts_of
from antumbra.techniques.chcrt import chc_rt
from antumbra.techniques.tracer_options import ChcRtOptions
from antumbra.trace.primary.primary_rays import trace_primary
from antumbra.trace.rays.ray_hits import nearest_hits
from cutout_scenes import holes
from devices import DEVICES
from double_rooms import ORDERS, TURNS, double_room, rays_inside
from strength import examples

SHAPE = 20, 24  # of pictures, and of passes of rays
N = SHAPE[0] * SHAPE[1]
LAYERS = "layers"
CASES = [(order, turn) for order in ORDERS for turn in TURNS] + [(LAYERS, 0.0)]


def layers(n=5, seed=0):
    """Planes across each axis, each with two grids of squares, shifted by half a square; random triangles are left out.

    The triangles of a plane face either way and overlap without having centres in common.
    """
    rng, soup = np.random.default_rng(seed), []
    i, j = (a.ravel() for a in np.meshgrid(np.arange(n), np.arange(n)))
    for axis in range(3):
        for height in range(n):
            for shift in (0.0, 0.5):
                corners = np.stack([i + shift, j + shift, np.full(n * n, height)], -1)
                square = corners[:, None] + [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
                halves = square[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 3)
                turned = np.where(rng.random(len(halves))[:, None, None] < 0.5, halves, halves[:, ::-1])
                soup.append(np.roll(turned, axis, -1))
    soup = np.concatenate(soup)
    return rng.permutation(soup[rng.random(len(soup)) < 0.4])


@cache
def case_of(order, turn):
    """(scene, world origins, directions, (t, face) of the oracle)."""
    if order == LAYERS:
        scene, rng = at.Scene.from_arrays(layers(), up="z"), np.random.default_rng(1)
        origins = rng.uniform(-2, 7, (N, 3)).astype(np.float32)
        directions = (rng.uniform(0, 5, (N, 3)) - origins).astype(np.float32)
    else:
        room = double_room(order, turn, seed=len(order))
        scene = at.Scene.from_arrays(room.vertices, room.faces, up="z")
        origins, directions = rays_inside(room, N)
    local = (origins - scene.origin).astype(np.float32)
    return scene, local + scene.origin, directions, _truth(scene, local, directions)


def _truth(scene, local, directions):
    vertices = scene.triangles().vertices
    t, face = oracle.closest_hit(vertices, local, directions)
    assert (face >= 0).mean() > 0.3
    return t, face


def _pass(scene, origins, directions):
    return RayPass((origins - scene.origin).astype(np.float32), directions, np.full(len(origins), -1, np.int32))


def _scheduled(scene):
    return chc_rt.prepare(BUILDERS["bsah"].build(scene.triangles().vertices, 1), ChcRtOptions(), 1)


def _in_list(scene, origins, directions, tmp_path):
    hit = scene.closest_hit(origins, directions)
    return hit.t, hit.face


def _incoherent(scene, origins, directions, tmp_path):
    order = np.random.default_rng(0).permutation(len(origins))
    hit, back = scene.closest_hit(origins[order], directions[order]), np.argsort(order)
    return hit.t[back], hit.face[back]


def _single(scene, origins, directions, tmp_path):
    hits = [scene.closest_hit(o, d) for o, d in zip(origins, directions)]
    return np.array([h.t for h in hits]), np.array([h.face for h in hits])


def _binary(scene, origins, directions, tmp_path):
    bvh = BUILDERS["lbvh"].build(scene.triangles().vertices, 1)
    return nearest_hits(bvh, *_pass(scene, origins, directions))[::-1]


def _scheduled_pass(scene, origins, directions, tmp_path):
    (hits,) = chc_rt.nearest_hits(_scheduled(scene), [_pass(scene, origins, directions)], SHAPE)
    return hits.t.ravel(), hits.face.ravel()


def _first_of(scene, origins, directions, limit):
    found = scene.all_hits(origins, directions, max_hits=limit)
    t, face, first = np.full(len(origins), np.inf), np.full(len(origins), -1), found.ray_offsets[:-1]
    some = found.counts > 0
    t[some], face[some] = found.t[first[some]], found.face[first[some]]
    assert limit is None or found.counts.max() == limit
    return t, face


def _first_of_all(scene, origins, directions, tmp_path):
    return _first_of(scene, origins, directions, None)


def _first_only(scene, origins, directions, tmp_path):
    return _first_of(scene, origins, directions, 1)


def _on_device(name):
    def hits(scene, origins, directions, tmp_path):
        return _in_list(at.Engine(scene, device=name), origins, directions, tmp_path)

    return hits


def _stored(scene, tmp_path):
    path = tmp_path / "a.antumbra"
    build_store([scene], path, chunk=16)
    return at.load(path)


def _in_store(scene, origins, directions, tmp_path):
    return _in_list(_stored(scene, tmp_path), origins, directions, tmp_path)


def _first_in_store(scene, origins, directions, tmp_path):
    return _first_of(_stored(scene, tmp_path), origins, directions, 1)


def _instanced(scene):
    """The scene's triangles as copies of two meshes, every other face in each; and the face in `scene` of its faces."""
    corners = scene.triangles().vertices.astype(np.float64) + scene.origin
    meshes = [(corners[k::2].reshape(-1, 3), np.arange(3 * len(corners[k::2])).reshape(-1, 3)) for k in range(2)]
    numbers = np.concatenate([np.arange(k, len(corners), 2) for k in range(2)])
    return at.Scene.from_instances(meshes, [np.eye(3, 4)[None]] * 2, up="z", instances=True), numbers


WAYS = {
    "a list of rays": _in_list,
    "rays that lie apart": _incoherent,
    "one ray at a time": _single,
    "a binary tree": _binary,
    "a pass of chcrt": _scheduled_pass,
    "the first of all hits": _first_of_all,
    "all hits, but at most one": _first_only,
    "a store": _in_store,
    "all hits in a store, but at most one": _first_in_store,
    "the host device": _on_device("host"),
    "OpenCL": _on_device("opencl"),
}
ON_DEVICES = [pytest.param(way, marks=pytest.mark.device(name)) for way, name in zip([*WAYS][-2:], DEVICES)]


@pytest.mark.parametrize("way", [*[*WAYS][:-2], *ON_DEVICES])
@pytest.mark.parametrize("order, turn", CASES)
def test_rays_hit_the_face_that_faces_them(order, turn, way, tmp_path):
    scene, origins, directions, (t, face) = case_of(order, turn)
    found_t, found = WAYS[way](scene, origins, directions, tmp_path)
    np.testing.assert_array_equal(found_t, t)
    np.testing.assert_array_equal(found, face)


@pytest.mark.parametrize("order, turn", CASES)
def test_rays_hit_the_same_faces_of_instances(order, turn):
    scene, origins, directions, _ = case_of(order, turn)
    copies, numbers = _instanced(scene)
    local = (origins - copies.origin).astype(np.float32)
    flat = at.Scene.from_arrays(scene.triangles().vertices[numbers] + scene.origin, up="z")
    assert np.array_equal(*(each.triangles().vertices + each.origin for each in (flat, copies)))
    t, face = oracle.closest_hit(copies.triangles().vertices, local, directions)
    world = local + copies.origin
    for found_t, found in (_in_list(copies, world, directions, None), _first_only(copies, world, directions, None)):
        np.testing.assert_array_equal(found_t, t)
        np.testing.assert_array_equal(found, face)


@pytest.mark.parametrize("order", ORDERS)
def test_every_ray_inside_a_double_room_hits_an_inner_face(order):
    room = double_room(order, 27.3, seed=len(order))
    _, _, _, (_, face) = case_of(order, 27.3)
    assert (room.walls[face] >= 0).all() and len(np.unique(room.walls[face])) == 6


@pytest.mark.parametrize("order, turn", [case for case in CASES if case[0] != "inner first"])
def test_the_lowest_face_would_often_be_another(order, turn):
    scene, origins, directions, (t, face) = case_of(order, turn)
    hits = scene.all_hits(origins, directions)
    lowest = np.full(len(t), scene.n_triangles)
    nearest = hits.t == t[hits.ray]
    np.minimum.at(lowest, hits.ray[nearest], hits.face[nearest])
    assert (lowest[face >= 0] != face[face >= 0]).mean() > 0.05


# --- Pictures ---------------------------------------------------------------------------------------------------------


def _camera(order, scene):
    if order == LAYERS:
        return at.Camera((-1.3, 7.1, 8.2), (2, 2, 2), (0, 0, 1), width=SHAPE[1], height=SHAPE[0])
    middle = scene.bounds.mean(0)
    return at.Camera(middle - (0.4, 0.3, 0.1), middle + (1, 0.7, -0.2), (0, 0, 1), 100, width=SHAPE[1], height=SHAPE[0])


def _light(scene):
    return at.PointLight(tuple(scene.bounds.mean(0)))


def _rasterised(triangles, rays):
    return rasterise(triangles.vertices.reshape(-1, 9), rays)


def _traced(triangles, rays):
    return trace_primary(block_tree(binned_sah.build(triangles.vertices, 1), 1), rays)


def _scheduled_picture(triangles, rays):
    return chc_rt.primary_hits(chc_rt.prepare(binned_sah.build(triangles.vertices, 1), ChcRtOptions(), 1), rays)


def _packets(triangles, rays):
    return trace_packets(deep_tree(binned_sah.build(triangles.vertices, 1), 1), rays, 1)


def _frusta(triangles, rays):
    return trace_frusta(block_tree(binned_sah.build(triangles.vertices, 1), 1, BLOCK), rays, 1)


PICTURES = {
    "raster": _rasterised,
    "rays": _traced,
    "chcrt": _scheduled_picture,
    "published packets": _packets,
    "published frusta": _frusta,
}


@cache
def picture_of(order, turn):
    """(scene, camera, (H, W) faces of the oracle)."""
    scene = case_of(order, turn)[0]
    camera = _camera(order, scene)
    rays = rays_through(camera.rays(scene.origin), np.ones(SHAPE, bool))
    face = _truth(scene, rays.origins, rays.directions)[1]
    return scene, camera, face.reshape(SHAPE)


@pytest.mark.parametrize("method", PICTURES)
@pytest.mark.parametrize("order, turn", CASES)
def test_pictures_show_the_face_that_faces_the_camera(order, turn, method):
    scene, camera, truth = picture_of(order, turn)
    face, t = PICTURES[method](scene.triangles(), camera.rays(scene.origin))
    np.testing.assert_array_equal(face, truth)
    np.testing.assert_array_equal(t, _rasterised(scene.triangles(), camera.rays(scene.origin))[1])


@pytest.mark.parametrize("order, turn", CASES)
def test_pictures_of_a_store_show_the_face_that_faces_the_camera(order, turn, tmp_path):
    scene, camera, truth = picture_of(order, turn)
    frame = Renderer(_stored(scene, tmp_path), None, 2).render(camera, _light(scene), spp=1)
    np.testing.assert_array_equal(frame.gbuffer.face, truth)


@pytest.mark.parametrize("projection", ["perspective", "orthographic", "panoramic"])
@pytest.mark.parametrize("order, turn", CASES)
def test_pixels_show_the_face_that_their_rays_hit(order, turn, projection, tmp_path):
    """In memory, in stores and of instances, by every projection."""
    scene, near = case_of(order, turn)[0], _camera(order, case_of(order, turn)[0])
    extent = 3.0 if projection == "orthographic" else None
    camera = at.Camera(
        near.position, near.target, near.up, near.vfov, near.width, near.height, projection=projection, extent=extent
    )
    for source in scene, _stored(scene, tmp_path), _instanced(scene)[0]:
        rays = rays_through(camera.view(source.origin), np.ones(SHAPE, bool))
        hit = source.closest_hit(rays.origins + source.origin, rays.directions)
        np.testing.assert_array_equal(source.engine.surfaces(camera).face.ravel(), hit.face)
        assert (hit.face >= 0).mean() > 0.02


def test_hits_are_compared_with_those_of_chunks_that_have_left_memory(tmp_path):
    scene, camera, truth = picture_of(LAYERS, 0.0)
    renderer = Renderer(_stored(scene, tmp_path), None, 2)
    room = renderer.source.residency.min_budget()
    renderer.source.budget = lambda *_: room
    frame = renderer.render(camera, _light(scene), spp=1)
    np.testing.assert_array_equal(frame.gbuffer.face, truth)
    hit = at.load(tmp_path / "a.antumbra").closest_hit(*case_of(LAYERS, 0.0)[1:3])
    np.testing.assert_array_equal(hit.face, case_of(LAYERS, 0.0)[3][1])
    assert frame.paging["loaded"] > len(renderer.source.store) > 5


@pytest.mark.parametrize("order, turn", CASES)
def test_cutouts_and_solid_faces_share_the_rule(order, turn):
    """Every third face is a cut-out without holes."""
    scene, origins, directions, (t, face) = case_of(order, turn)
    n = scene.n_triangles
    masks = [holes(np.ones((2, 2), bool), (0, 0))]
    cut = at.Scene.from_arrays(scene.triangles().vertices + scene.origin, up="z")
    mask = np.where(np.arange(n) % 3 == 0, 0, -1).astype(np.int32)
    cut.data.cutouts = cutouts_of(np.zeros((n, 3, 2), np.float32), mask, masks)
    for found_t, found in (
        _in_list(cut, origins, directions, None),
        _first_of_all(cut, origins, directions, None),
        _first_only(cut, origins, directions, None),
    ):
        np.testing.assert_array_equal(found_t, t)
        np.testing.assert_array_equal(found, face)
    _, camera, truth = picture_of(order, turn)
    for method in ("raster", "rays"):
        frame = at.render(cut, camera, _light(scene), spp=1, gbuffer=method)
        np.testing.assert_array_equal(frame.gbuffer.face, truth)


# --- Hard scenes ------------------------------------------------------------------------------------------------------


@examples(60)
@given(seed=st.integers(0, 2**32 - 1), n=st.integers(2, 30), power=st.sampled_from([-30, 0, 20]))
def test_small_whole_numbers_agree_with_the_oracle(seed, n, power):
    """Triangles that coincide, cross, and meet at edges and corners, seen from all sides; every way to a hit."""
    rng = np.random.default_rng(seed)
    soup = rng.integers(-2, 3, (n, 3, 3)).astype(float)
    soup = rng.permutation(np.concatenate([soup, soup[: n // 2, rng.permutation(3)], soup[:, ::-1]])) * 2.0**power
    scene = at.Scene.from_arrays(soup)
    vertices = scene.triangles().vertices
    origins = (rng.integers(-6, 7, (64, 3)) * 2.0**power).astype(np.float32)
    directions = (vertices[rng.integers(0, len(vertices), 64)].mean(1) - origins).astype(np.float32)
    directions[::2] = rng.integers(-3, 4, (32, 3))
    directions[~directions.any(1)] = 1.0
    t, face = oracle.closest_hit(vertices, origins, directions)
    world = origins + scene.origin
    for way in (_in_list, _incoherent, _binary, _first_of_all):
        found_t, found = way(scene, world, directions, None)
        np.testing.assert_array_equal(found_t, t)
        np.testing.assert_array_equal(found, face)
    found_t, found = _scheduled_pass_of(scene, world, directions)
    np.testing.assert_array_equal(found_t, t)
    np.testing.assert_array_equal(found, face)


def _scheduled_pass_of(scene, origins, directions):
    (hits,) = chc_rt.nearest_hits(_scheduled(scene), [_pass(scene, origins, directions)], (8, 8))
    return hits.t.ravel(), hits.face.ravel()
