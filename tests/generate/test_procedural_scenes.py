"""Procedural scenes: the requested number of triangles, the same scene every time, and watertight geometry."""

import io
import os
import signal
from itertools import islice

import numpy as np
import pytest

from antumbra.base.errors import InputError
from antumbra.generate import atrium, city, props, shapes
from antumbra.generate.procedural_scenes import (
    MAX_TRIANGLES,
    MIN_TRIANGLES,
    PROCEDURAL,
    city_blocks,
    city_view,
    generate,
)
from antumbra.generate.shapes import PaletteMesh, assemble, count, fitted, place_copies
from antumbra.lab.papers.scenes import bedroom, furnishings, museum_halls
from antumbra.scene.camera import Camera
from antumbra.scene.lights import QuadLight

NAMES = list(PROCEDURAL)
SIZE = 20_000


@pytest.fixture(scope="module", params=NAMES)
def scene(request):
    return generate(request.param, SIZE)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("triangles, seed", [(10_000, 0), (14_321, 1), (37_000, 2), (250_000, 3), (800_000, 0)])
def test_the_number_of_triangles_is_met_within_ten_per_cent(name, triangles, seed):
    assert len(generate(name, triangles, seed).faces) == pytest.approx(triangles, rel=0.1)


@pytest.mark.parametrize("name", NAMES)
def test_the_default_size_and_the_smallest_one(name):
    default = PROCEDURAL[name].default_triangles
    assert len(generate(name).faces) == pytest.approx(default, rel=0.05)
    assert len(generate(name, MIN_TRIANGLES).faces) < 8_000


@pytest.mark.parametrize("name", NAMES)
def test_same_arguments_same_bits_and_other_seeds_differ(name):
    one, again, other = generate(name, SIZE, 5), generate(name, SIZE, 5), generate(name, SIZE, 6)
    for a, b in zip(one[:4], again[:4]):
        np.testing.assert_array_equal(a, b)
    assert one.camera == again.camera and one.light == again.light
    assert one.vertices.shape != other.vertices.shape or (one.vertices != other.vertices).any()


def test_arrays_are_well_formed(scene):
    assert scene.vertices.dtype == np.float32 and np.isfinite(scene.vertices).all()
    assert scene.faces.dtype == np.int32 and scene.faces.flags.c_contiguous
    np.testing.assert_array_equal(np.unique(scene.faces), np.arange(len(scene.vertices)))
    assert scene.colour.dtype == np.uint8 and scene.colour.shape == scene.faces.shape[:1]
    assert scene.palette.dtype == np.float32 and scene.palette.shape == (256, 3)
    assert scene.palette.min() >= 0.0 and scene.palette.max() <= 1.0
    assert len(np.unique(scene.colour)) > 20


def test_triangles_have_area_and_occur_once(scene):
    corners = scene.vertices[scene.faces].astype(np.float64)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2.0
    assert np.mean(area < 1e-9) < 1e-3
    keys = np.sort(scene.faces, axis=1)
    assert len(np.unique(keys, axis=0)) == len(keys)


def test_camera_and_light_are_placed_sensibly(scene):
    camera, light = Camera(**scene.camera), QuadLight(**scene.light)
    lower, upper = scene.vertices.min(axis=0), scene.vertices.max(axis=0)
    size = np.linalg.norm(upper - lower)
    assert lower[1] < camera.position[1] < upper[1] + size
    assert (np.abs(camera.position - (lower + upper) / 2)[[0, 2]] < 0.75 * (upper - lower)[[0, 2]]).all()
    assert light.area() > 0.5
    corners = light.corner + np.array([[0, 0], [1, 0], [0, 1], [1, 1]]) @ np.array([light.u, light.v])
    floor = scene.camera["position"][1] - 1.7 if scene.camera["position"][1] < 20 else 0.0
    assert corners[:, 1].min() > floor + 0.5
    assert np.linalg.norm(corners - (lower + upper) / 2, axis=1).max() < 4.0 * size


def test_the_camera_sees_surfaces_in_light_and_in_shadow(scene):
    camera = Camera(**scene.camera, width=12, height=12)
    rays = camera.rays(np.zeros(3))
    y, x = np.mgrid[0:12, 0:12] + 0.5
    directions = (rays.corner + x[..., None] * rays.dx + y[..., None] * rays.dy).reshape(-1, 3)
    triangles = scene.vertices[scene.faces].astype(np.float64)
    position = camera.position
    t, face = _nearest(position, directions, triangles)
    hit = np.isfinite(t)
    assert hit.mean() > 0.5
    assert t[hit].min() > 0.5, "something sits on the camera"
    corners = triangles[face[hit]]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal *= -np.sign(np.sum(normal * directions[hit], axis=1, keepdims=True))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    points = position + directions[hit] * t[hit, None] + 1e-3 * normal
    light = scene.light
    to_light = np.array(light["corner"]) + (np.array(light["u"]) + np.array(light["v"])) / 2.0 - points
    facing = np.sum(to_light * normal, axis=1) > 0.0
    blocked = np.array(
        [_nearest(o, d[None], triangles)[0][0] < 0.999 for o, d in zip(points[facing], to_light[facing])]
    )
    assert 0.03 < blocked.mean() < 0.9


def _nearest(origin, directions, triangles):
    """(t, index) of the nearest triangle, by Moeller and Trumbore in float64. t is in lengths of the direction."""
    a, e1, e2 = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    s = origin - a
    q = np.cross(s, e1)
    best, which = np.full(len(directions), np.inf), np.zeros(len(directions), int)
    for i, direction in enumerate(directions):
        h = np.cross(direction, e2)
        with np.errstate(divide="ignore", invalid="ignore"):
            f = 1.0 / np.sum(e1 * h, axis=1)
            u, v, t = f * np.sum(s * h, axis=1), f * (q @ direction), f * np.sum(e2 * q, axis=1)
            t = np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 1e-9), t, np.inf)
        which[i] = np.argmin(t)
        best[i] = t[which[i]]
    return best, which


def _solids():
    rng = np.random.default_rng(0)
    flat = city.Style(3.0, 0.5, False, 0, 8, 0.3)
    for detail in (0.2, 1.0, 2.0):
        yield f"baluster {detail}", atrium.baluster(0.8, detail)
        yield f"column {detail}", atrium.column(4.0, 0.35, 12, round(2 * detail))
        yield f"vase {detail}", props.vase(1.0, detail)
        yield f"pot {detail}", props.pot(0.5, 0.4, detail)
        yield f"barrel {detail}", props.barrel(1.0, 0.4, detail)
        yield f"bush {detail}", props.bush(rng, 1.0, detail)
        yield f"trunk {detail}", props.bare_tree(rng, 8.0, detail).wood
        yield f"car {detail}", city.car(0, detail)
        yield f"lamp {detail}", city.lamp(detail)
        yield f"bed {detail}", furnishings.bed(1.7, 2.0, detail, rng)
        yield f"armchair {detail}", furnishings.armchair(detail, rng)
        yield f"drawers {detail}", furnishings.drawers(1.2, 0.8, 0.4, 3, 2, detail)
        yield f"table lamp {detail}", furnishings.table_lamp(0.5, detail)
        yield f"book {detail}", furnishings.book(detail, 8)
        yield f"door {detail}", furnishings.door(0.9, 2.0, detail)
        yield f"bookcase {detail}", assemble(furnishings.bookcase(1.2, 2.0, 0.3, 5, detail, rng))
        yield f"chandelier {detail}", assemble(furnishings.chandelier(0.6, detail))
        yield f"blind {detail}", assemble(bedroom.panel(1.1, 2.3, -0.3, detail, rng))
        yield f"curtains {detail}", assemble(bedroom.curtains(2.6, 0, detail, rng))
        yield (
            f"toys {detail}",
            shapes.merge(*(toy(detail) for toy in (furnishings.blocks, furnishings.rings, furnishings.train))),
        )
        yield f"bear {detail}", furnishings.bear(0.5, detail)
        yield f"beach ball {detail}", furnishings.beach_ball(0.2, detail)
    for triangles in (50, 3000):
        yield f"knot {triangles}", museum_halls.knot(triangles)
        yield f"blob {triangles}", museum_halls.blob(triangles, rng)
        yield f"twist {triangles}", museum_halls.twist(triangles)
        yield f"ammonite {triangles}", museum_halls.ammonite(triangles)
        yield f"ribbon {triangles}", museum_halls.ribbon(triangles)
    yield "box", shapes.box((1, 2, 3))
    yield "bevelled box", shapes.box((1, 2, 3), bevel=0.2)
    yield "moulding", shapes.frame_ring([(0, 0), (0.2, 0), (0.2, 0.3), (0, 0.3)], 5, 9)
    yield "arch", atrium.arch(1.6, 2.2, 0.6, 9)
    yield "doorway", atrium.doorway(5.0, 0.8, 2.0, 3.5, 0.5, 9)
    yield "voussoirs", atrium.voussoirs(1.6, 0.3, 0.7, 9, 2)
    yield "vault", atrium.vault(1.75, 1.9, 2.2, 5)
    yield "wall", atrium.ashlar(4.0, 3.0, 0.4, 0.5, rng)
    yield "wall with a window", bedroom.pierced((-3.0, 0.0), (3.0, 2.8), 0.3)
    yield "stairs", atrium.stairs(9, 1.5, 0.2, 0.25)
    yield "crate", props.crate((1.0, 0.8, 0.7), 4)
    yield "curtain", props.cloth((2.0, 3.0), (20, 12), rng, sway=1.0)
    yield "painting", museum_halls.painting(2.0, 1.5, 6, rng)
    yield "house", city.house(9.0, 8.0, 2, flat, rng)
    yield "round tower", city.round_tower(6.0, 5, 12, rng)
    for relief in (False, True):
        yield f"tower {relief}", city.tower(12.0, 9.0, 4, flat._replace(relief=relief), rng)


@pytest.mark.parametrize("name, mesh", list(_solids()), ids=lambda x: x if isinstance(x, str) else "")
def test_solids_are_closed_and_face_outwards(name, mesh):
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    edges = edges[:, 0].astype(np.int64) * len(mesh.vertices) + edges[:, 1]
    back = edges % len(mesh.vertices) * len(mesh.vertices) + edges // len(mesh.vertices)
    assert len(np.unique(edges)) == len(edges), "an edge is passed twice in the same direction"
    np.testing.assert_array_equal(np.sort(edges), np.sort(back))
    corners = mesh.vertices[mesh.faces].astype(np.float64)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert np.linalg.norm(normals, axis=1).min() > 1e-9
    for body in _bodies(mesh):
        a, b, c = (mesh.vertices[mesh.faces[body, i]].astype(np.float64) for i in range(3))
        middle = a.mean(axis=0)
        assert np.sum(np.cross(a - middle, b - middle) * (c - middle)) > 0.0


def _bodies(mesh):
    """Masks of faces, one for each connected part of a mesh."""
    label = np.arange(len(mesh.vertices))
    while True:
        least = label[mesh.faces].min(axis=1)
        spread = label.copy()
        np.minimum.at(spread, mesh.faces.ravel(), np.repeat(least, 3))
        spread = spread[spread]
        if (spread == label).all():
            break
        label = spread
    of_face = label[mesh.faces[:, 0]]
    return [of_face == k for k in np.unique(of_face)]


def test_tower_cost_is_exact():
    rng = np.random.default_rng(0)
    for relief in (False, True):
        for ledge in (0.0, 0.3):
            style = city.Style(3.0, 0.5, relief, 0, 8, ledge)
            mesh = city.tower(13.0, 8.0, 5, style, rng)
            assert len(mesh.faces) == city.tower_cost(13.0, 8.0, 5, style)


def test_parts_are_counted_placed_and_shaded():
    mesh = shapes.box((2.0, 4.0, 6.0), (0.0, 2.0, 0.0), colour=16)
    parts = [place_copies(mesh, [(10, 0, 0), (0, 0, 20)], [np.pi / 2, 0.0], 0.5, shade=[1, 2]), place_copies(mesh)]
    whole = assemble(parts)
    assert count(parts) == len(whole.faces) == 36
    first = whole.vertices[:8]
    np.testing.assert_allclose([first.min(axis=0), first.max(axis=0)], [(8.5, 0, -0.5), (11.5, 2, 0.5)], atol=1e-6)
    assert [set(whole.colour[k : k + 12]) for k in (0, 12, 24)] == [{17}, {18}, {16}]


def test_fitted_finds_the_detail_or_takes_the_coarsest():
    def build_some(detail):
        n = 2 * max(5, round(100 * detail**2))
        return [
            place_copies(PaletteMesh(np.zeros((3, 3), np.float32), np.zeros((n, 3), np.int32), np.zeros(n, np.uint8)))
        ]

    for wanted in (60, 500, 12_345, 1_000_000):
        assert 0.93 * wanted <= count(fitted(build_some, wanted, 1.0)) <= wanted
    assert count(fitted(build_some, 3, 1.0)) == 10


def test_city_comes_in_blocks():
    pieces = list(city_blocks(90_000, seed=4))
    scene = generate("city", 90_000, seed=4)
    assert len(pieces) > 3
    np.testing.assert_array_equal(np.concatenate([v for v, _, _ in pieces]), scene.vertices)
    np.testing.assert_array_equal(np.concatenate([c for _, _, c in pieces]), scene.colour)
    for vertices, faces, _ in pieces:
        assert faces.min() == 0 and faces.max() == len(vertices) - 1


def test_the_largest_city_can_be_streamed():
    pieces = list(islice(city_blocks(MAX_TRIANGLES), 4))
    assert all(5_000 < len(faces) < 100_000 for _, faces, _ in pieces)
    camera, light = city_view(MAX_TRIANGLES)
    Camera(**camera), QuadLight(**light)


@pytest.mark.parametrize(
    "arguments, message",
    [
        (("attic",), "no procedural scene 'attic'; choose one of atrium, city, forest, cellar, museum, blinds"),
        (("atrium", 10), "triangles is 10; it must be a whole number from 1000 to 400000000"),
        (("city", MAX_TRIANGLES + 1), "triangles is 400000001"),
        (("city", 5000.5), "triangles is 5000.5"),
        (("forest", "many"), "triangles is 'many'"),
        (("forest", float("nan")), "triangles is nan"),
        (("museum", 5000, -1), "seed is -1"),
    ],
)
def test_bad_requests_say_what_is_wrong(arguments, message):
    with pytest.raises(InputError) as error:
        generate(*arguments)
    assert message in str(error.value) and "\n" not in str(error.value)


def test_a_bad_city_is_refused_before_its_first_block():
    with pytest.raises(InputError, match="triangles is 0"):
        city_blocks(0)


@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
def test_workers_that_are_stopped_for_a_while_lose_no_bytes():
    """As by Ctrl-Z: a write to a pipe ends early then, and Python's buffered files lose the rest of it."""
    expected = [block for group in city.city_groups(150_000, 3) for block in group]
    worker = city.start_worker(150_000, 3, 0, 1)
    assert worker.stdout is not None
    try:
        for block in expected:
            os.kill(worker.pid, signal.SIGSTOP)
            os.kill(worker.pid, signal.SIGCONT)
            received = city._receive(worker.stdout)
            assert received is not None
            for ours, theirs in zip(received, block):
                np.testing.assert_array_equal(ours, theirs)
        assert city._receive(worker.stdout) is None and worker.wait() == 0
    finally:
        worker.kill()
        worker.stdout.close()
        worker.wait()


@pytest.mark.parametrize("sizes", [[3], [3, -1], [1 << 40, 2], [3, 1]])
def test_blocks_that_cannot_be_ones_are_refused(sizes):
    pipe = io.BufferedReader(io.BytesIO(np.array(sizes, np.int64).tobytes() + b"end"))
    with pytest.raises(RuntimeError, match="ended too early"):
        city._receive(pipe)
