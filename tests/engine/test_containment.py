"""`contains`: bodies drawn twice, shared walls, open surfaces and their notes, in memory, stores and instances."""

from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import antumbra as at
from antumbra.query.ray_list import RayArguments

FACES = np.array([[0, 1, 2], [0, 3, 1], [1, 3, 2], [0, 2, 3]])
UNIT_BOX = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
BOX_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]]
)  # fmt: skip
BOX = UNIT_BOX[BOX_FACES]
WITHOUT_TOP = BOX[~(BOX[:, :, 2] == 1).all(1)]
FLOOR = BOX[(BOX[:, :, 2] == 0).all(1)]


AXES = np.concatenate([np.eye(3), -np.eye(3)])
DIAGONALS = np.array(list(product((-1.0, 1.0), repeat=3)))


def both_sides(faces):
    return np.concatenate([faces, faces[:, ::-1]])


def grid(low=-1.0, high=2.0, n=13):
    """Points in a cube, none on a face, edge or diagonal of the unit box."""
    steps = np.linspace(low, high, n) + np.array([[0.011], [0.023], [0.037]])
    return np.stack(np.meshgrid(*steps, indexing="ij"), axis=-1).reshape(-1, 3)


def in_box(points, low=(0, 0, 0), high=(1, 1, 1)):
    return ((points > low) & (points < high)).all(-1)


def determinant(a, b, c):
    return a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) + a[2] * (b[0] * c[1] - b[1] * c[0])


def in_tetrahedron(point, corners):
    """1 inside, 0 on the surface, -1 outside, in rational arithmetic."""
    p = [[Fraction(float(x)) - Fraction(float(o)) for x, o in zip(corner, point)] for corner in corners]
    parts = [
        determinant(p[b], p[c], p[d]) * sign
        for b, c, d, sign in ((1, 2, 3, 1), (0, 2, 3, -1), (0, 1, 3, 1), (0, 1, 2, -1))
    ]
    whole = sum(parts)
    if any(part * whole < 0 for part in parts):
        return -1
    return 0 if any(part == 0 for part in parts) else 1


small = st.integers(0, 3)
corner = st.tuples(small, small, small)
tetrahedra = st.tuples(corner, corner, corner, corner).filter(
    lambda t: determinant(*[[x - y for x, y in zip(t[k], t[0])] for k in (1, 2, 3)]) != 0
)


@settings(deadline=None, max_examples=60)
@given(
    st.lists(st.tuples(tetrahedra, st.sampled_from(["once", "per side", "twice", "partly"])), min_size=1, max_size=4),
    st.lists(st.tuples(*[st.integers(-2, 44)] * 3), min_size=1, max_size=12),
)
def test_bodies_apart_contain_the_points_of_rational_arithmetic_however_often_they_are_drawn(bodies, points):
    corners = np.array([body for body, _ in bodies], float) + 4.0 * np.arange(len(bodies))[:, None, None]
    drawn = []
    for body, (_, how) in zip(corners, bodies):
        faces = body[FACES]
        again = {"once": faces[:0], "per side": faces[:, ::-1], "twice": faces, "partly": faces[:2, ::-1]}[how]
        drawn += [faces, again]
    scene, points = at.Scene.from_arrays(np.concatenate(drawn)), np.array(points) / 3.0
    points = np.concatenate([points.astype(np.float32), corners.mean(1).astype(np.float32)])
    points = (points - scene.origin).astype(np.float32) + scene.origin
    truth = [any(in_tetrahedron(p, body) >= 0 for body in corners) for p in points]
    assert any(truth)
    np.testing.assert_array_equal(scene.contains(points), truth)
    assert scene.notes == ()


@pytest.mark.parametrize("up", ["y", "z"])
def test_bodies_in_contact_contain_both_sides_of_their_wall(up):
    scene = at.Scene.from_arrays(np.concatenate([BOX, BOX + (1, 0, 0)]), up=up)
    points = grid()
    inside = in_box(points, (0, 0, 0), (2, 1, 1)) & (points[:, 0] != 1)
    np.testing.assert_array_equal(scene.contains(points), inside)
    twice = at.Scene.from_arrays(both_sides(np.concatenate([BOX, BOX + (3, 0, 0)])), up=up)
    np.testing.assert_array_equal(twice.contains(points), in_box(points))


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("faces", [FLOOR, both_sides(FLOOR), FLOOR + [0.2, 0.1, 0] * FLOOR[..., :1]], ids=str)
def test_sheets_contain_nothing_and_have_a_note(faces, up):
    scene = at.Scene.from_arrays(faces @ np.array([[0.6, 0, 0.8], [0, 1, 0], [-0.8, 0, 0.6]]), up=up)
    points = np.random.default_rng(0).uniform(-1, 2, (2000, 3))
    assert not scene.contains(points).any()
    assert len(scene.notes) == 1 and "4 edges are open" in scene.notes[0]


@pytest.mark.parametrize("faces", [WITHOUT_TOP, both_sides(WITHOUT_TOP)], ids=["once", "once per side"])
def test_an_open_box_contains_nothing_outside_its_bounds_and_the_points_near_its_floor(faces):
    scene, points = at.Scene.from_arrays(faces, up="z"), grid()
    inside = scene.contains(points)
    assert not inside[~in_box(points)].any()
    assert inside[in_box(points, (0, 0, 0), (1, 1, 0.5))].all()
    assert scene.notes == (scene.notes[0],) and "4 edges are open" in scene.notes[0]
    scene.contains(points)
    assert len(scene.notes) == 1


def test_the_note_follows_an_update():
    scene = at.Scene.from_arrays(BOX, up="z")
    scene.contains([0.5, 0.5, 0.5])
    assert scene.notes == ()
    corners = BOX.copy()
    corners[0, 0] += 0.25
    scene.update(corners)
    scene.contains([0.5, 0.5, 0.5])
    assert "4 edges are open" in scene.notes[0]
    scene.update(BOX + (5, 0, 0))
    np.testing.assert_array_equal(scene.contains([(0.5, 0.5, 0.5), (5.5, 0.5, 0.5)]), [False, True])
    assert scene.notes == ()


def test_a_store_keeps_points_outside_its_bounds_outside(tmp_path):
    at.build_store(
        at.Scene.from_arrays(np.concatenate([WITHOUT_TOP, FLOOR - (3, 0, 0)]), up="z"), tmp_path / "a.antumbra"
    )
    points = grid(-5, 5)
    inside = at.load(tmp_path / "a.antumbra").contains(points)
    assert not inside[~in_box(points, (-3, 0, 0), (1, 1, 1))].any()
    assert inside[in_box(points, (0, 0, 0), (1, 1, 1))].sum() == 0  # straight up is the hole


PLACES = [np.eye(4), np.array([[0, -1, 0, 5], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])]


@pytest.mark.parametrize(
    "meshes, places",
    [
        ([BOX], [PLACES]),
        ([both_sides(BOX)], [PLACES]),
        ([BOX], [[*PLACES, PLACES[0]]]),
        ([BOX, BOX[:, ::-1]], [PLACES, PLACES]),
        ([WITHOUT_TOP], [PLACES]),
    ],
    ids=["closed", "drawn twice", "two copies in one place", "a mesh per side", "open"],
)
def test_instances_contain_the_points_of_the_flattened_scene(meshes, places):
    scenes = [at.Scene.from_instances(meshes, places, up="z", instances=each) for each in (True, False)]
    points = grid(-1, 6, 23)
    instanced, flat = (scene.contains(points) for scene in scenes)
    np.testing.assert_array_equal(instanced, flat)
    assert flat[in_box(points, (0, 0, 0), (1, 1, 0.4))].all() and flat[in_box(points, (4, 0, 0), (5, 1, 0.4))].all()
    assert scenes[0].notes == scenes[1].notes
    assert bool(scenes[0].notes) == (len(meshes[0]) == len(WITHOUT_TOP))


def _all_votes(bodies, points, threads=1):
    """The majority of all 14 rays, without an early end."""
    odd = np.zeros(len(points), int)
    for along in [*AXES, *DIAGONALS]:
        rays = RayArguments(points, along, 0.0, np.inf, -1.0, (len(points),), 0, False, (0.0, 0.0, 0.0), 0.0)
        odd_now = bodies.crossings(rays, threads) % 2
        odd += odd_now
        if along.tolist() == [0.0, 0.0, -1.0]:  # the last axis
            agree = (odd == 6) | (odd == 0)
            inside = odd == 6
    return np.where(agree, inside, 2 * odd > 14)


@pytest.mark.parametrize("seed", range(4))
def test_rays_that_cannot_decide_are_left_out_and_change_no_answer(seed, monkeypatch):
    rng = np.random.default_rng(seed)
    bodies = [BOX * rng.uniform(0.5, 2, 3) + rng.uniform(-1, 1, 3) for _ in range(4)]
    scene = at.Scene.from_arrays(np.concatenate([body[rng.random(12) > 0.15] for body in bodies]))
    points = rng.uniform(*scene.bounds, (3000, 3)).astype(np.float32)
    inside, traced = scene.contains(points), []
    found = scene.engine.source.ray_lists.bodies(0.0)
    frame = (points - scene.origin).astype(np.float32)
    assert (inside == _all_votes(found, frame)).all() and 0.05 < inside.mean() < 0.95
    counted = found._replace(crossings=lambda rays, n: (traced.append(rays.n), found.crossings(rays, n))[1])
    monkeypatch.setattr(scene.engine.source.ray_lists, "_bodies", (scene.triangles(0.0), counted))
    assert (scene.contains(points) == inside).all()
    assert sum(traced) < 10 * len(points)  # of 14
    assert all((scene.contains(points[k : k + 10]) == inside[k : k + 10]).all() for k in range(0, 300, 10))
