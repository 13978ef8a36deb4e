"""View factors: closed forms, closed rooms, and brute force."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
import oracle
import radiation_shapes as shapes
from antumbra.city.sensors.surface_groups import surface_groups
from antumbra.city.view_factors.hemisphere_rays import REPLICATES, HemisphereRays
from strength import examples

SIGMAS = 6.0  # of eight replicates: exceeded once in 2000 numbers; seeds are fixed


def check(found, i, j, exact, most):
    """Compare F_ij with a closed form, by its standard error, which is at most `most`."""
    factor, error = found.factors[i, j], found.errors[i, j]
    assert 0.0 < error < most and abs(factor - exact) < SIGMAS * error, (factor, exact, error)


@pytest.mark.parametrize("size", [(1, 1, 1), (2, 1, 0.5), (1, 3, 2)])
def test_parallel_rectangles(size):
    a, b, c = size
    scene, parts = shapes.scene_of(
        shapes.rectangle((0, 0, 0), (a, 0, 0), (0, b, 0)), shapes.rectangle((0, 0, c), (0, b, 0), (a, 0, 0))
    )
    found = at.view_factors(scene, parts, samples=1 << 16)
    exact = shapes.parallel_rectangles(a, b, c)
    check(found, 0, 1, exact, 1e-3)
    check(found, 1, 0, exact, 1e-3)
    assert found.sky[0] == 1.0 - found.factors[0, 1] and found.ground[0] == 0.0
    assert found.ground[1] == 1.0 - found.factors[1, 0] and found.sky[1] == 0.0


@pytest.mark.parametrize("size", [(1, 1, 1), (2, 1, 3), (1, 0.5, 0.25)])
def test_perpendicular_rectangles(size):
    length, width, height = size
    scene, parts = shapes.scene_of(
        shapes.rectangle((0, 0, 0), (length, 0, 0), (0, width, 0)),
        shapes.rectangle((0, 0, 0), (0, 0, height), (length, 0, 0)),
    )
    found = at.view_factors(scene, parts, samples=1 << 16)
    check(found, 0, 1, shapes.perpendicular_rectangles(length, width, height), 1e-3)
    check(found, 1, 0, shapes.perpendicular_rectangles(length, height, width), 1e-3)


def test_coaxial_disks():
    scene, parts = shapes.scene_of(shapes.disk(0.0, 1.0), shapes.disk(0.7, 0.6, -1.0))
    found = at.view_factors(scene, parts, samples=1 << 16)
    assert np.allclose(found.areas, [np.pi, 0.36 * np.pi])
    check(found, 0, 1, shapes.coaxial_disks(1.0, 0.6, 0.7), 2e-3)
    check(found, 1, 0, shapes.coaxial_disks(0.6, 1.0, 0.7), 2e-3)


def test_a_sphere_and_a_disk():
    scene, parts = shapes.scene_of(shapes.sphere((0, 0, 0), 0.5), shapes.disk(-1.5, 2.0))
    found = at.view_factors(scene, parts, samples=1 << 16)
    exact = shapes.sphere_to_disk(2.0, 1.5)
    check(found, 0, 1, exact, 2e-3)
    check(found, 1, 0, exact * found.areas[0] / found.areas[1], 2e-3)
    assert (0, 0) not in zip(*found.factors.nonzero()) and found.sky[1] > 0.5


def test_a_convex_body_sees_its_enclosure_alone():
    outer, inner = np.concatenate(shapes.box((4, 3, 5))), np.concatenate(shapes.box((1, 1, 1), -1.0)) + (1, 1, 2)
    scene, parts = shapes.scene_of(outer, inner)
    found = at.view_factors(scene, parts, samples=1 << 14)
    assert found.factors[1, 1] == 0.0 and found.factors[1, 0] == 1.0 and not found.other.any()
    check(found, 0, 1, found.areas[1] / found.areas[0], 2e-3)
    assert found.factors[0, 0] + found.factors[0, 1] == 1.0


def test_an_obstacle_blocks():
    floor, ceiling = shapes.box((1, 1, 1))[0], shapes.box((1, 1, 1))[3]
    screen = shapes.rectangle((-1, -1, 0.5), (3, 0, 0), (0, 3, 0))
    scene, parts = shapes.scene_of(floor, ceiling, screen)
    parts[parts == 2] = -1
    found = at.view_factors(scene, parts, samples=1 << 10)
    assert len(found) == 2 and found.factors.nnz == 0
    assert (found.other > 0.5).all() and (found.other + found.sky + found.ground == 1.0).all()


@examples(12)
@given(
    st.tuples(*[st.floats(0.05, 20)] * 3), st.sampled_from(["front", "back"]), st.integers(0, 1 << 32),
    st.tuples(*[st.floats(-1e6, 1e6)] * 3),
)  # fmt: skip
def test_rows_of_a_closed_room_sum_to_one_exactly(size, side, seed, corner):
    room = np.concatenate(shapes.box(size, 1.0 if side == "front" else -1.0)) + corner
    scene = at.Scene.from_arrays(room, up="z")
    found = at.view_factors(scene, np.repeat(np.arange(6), 2), samples=1 << 10, side=side, seed=seed)
    assert (found.factors.sum(axis=1) == 1.0).all()
    assert not (found.sky.any() or found.ground.any() or found.other.any()) and not found.factors.diagonal().any()


def test_a_room_in_closed_form():
    a, b, c = 2.0, 3.0, 4.0
    scene = at.Scene.from_arrays(np.concatenate(shapes.box((a, b, c))), up="z")
    found = at.view_factors(scene, samples=1 << 16)
    assert len(found) == 6 and found.names == [f"arrays/{k}" for k in range(6)]
    part = surface_groups(scene, "surface").of_face[::2].tolist()  # of each rectangle of the box
    check(found, part[0], part[3], shapes.parallel_rectangles(a, b, c), 1e-3)
    check(found, part[0], part[1], shapes.perpendicular_rectangles(b, a, c), 1e-3)
    check(found, part[0], part[2], shapes.perpendicular_rectangles(a, b, c), 1e-3)
    exact = shapes.parallel_rectangles(a, b, c)
    both = found.reciprocal()
    check(both, part[0], part[3], exact, 1e-3)
    assert both.errors[part[0], part[3]] < found.errors[part[0], part[3]]


def test_counts_equal_brute_force():
    rng = np.random.default_rng(3)
    room, clutter = (
        np.concatenate(shapes.box((2, 2, 2))),
        rng.uniform(0.2, 1.8, (20, 1, 3)) + rng.normal(0, 0.3, (20, 3, 3)),
    )
    scene = at.Scene.from_arrays(np.concatenate([room, clutter]), up="z")
    groups = np.concatenate([np.repeat(np.arange(6), 2), rng.integers(5, 9, 20)])
    samples, n = 128, 9
    rays = HemisphereRays(scene.triangles(), groups, samples, 1.0, 7)
    made = rays.of_groups(0, n)
    assert made.origins.shape == (n * samples, 3) and (np.repeat(np.arange(n), samples) == groups[made.faces]).all()
    counts = np.zeros((n, n + 3), int)
    vertices = scene.triangles().vertices
    local = (made.origins - scene.origin).astype(np.float32)
    for k, (origin, direction, face) in enumerate(zip(local, made.directions.astype(np.float32), made.faces)):
        hits = []
        for f in range(len(vertices)):
            side, t = oracle.meets_exactly(origin, direction, vertices[f])
            if side and f != face:
                hits.append((t, f, side))
        if hits:
            _, f, side = min(hits)
            front = np.dot(np.cross(*np.diff(vertices[f].astype(float), axis=0)), direction) < 0.0
            column = groups[f] if front else n + 2
        else:
            column = n if direction[2] > 0 else n + 1
        counts[k // samples, column] += 1
    found = at.view_factors(scene, groups, samples=samples, seed=7)
    assert (
        (found.matrix.toarray() * samples == counts).all() and (counts[:, :n] > 0).sum() > 20 and counts[:, n + 2].any()
    )


@pytest.mark.parametrize("threads", [1, 2])
def test_results_depend_on_the_seed_alone(threads):
    scene = at.procedural("atrium", triangles=1000)
    numbers = surface_groups(scene, "surface").of_face % 40
    one = at.view_factors(scene, numbers, samples=256, seed=4)
    other = at.view_factors(scene, numbers, samples=256, seed=4, threads=threads)
    assert (one.matrix != other.matrix).nnz == 0 and (one.errors != other.errors).nnz == 0
    assert (one.matrix != at.view_factors(scene, numbers, samples=256, seed=5).matrix).nnz > 0


def test_surfaces_do_not_depend_on_the_others(monkeypatch):
    scene = at.procedural("atrium", triangles=1000)
    one = at.view_factors(scene, "surface", samples=256)
    monkeypatch.setattr("antumbra.city.view_factors.view_factors.RAYS_PER_PART", 3 * 256)
    other = at.view_factors(scene, "surface", samples=256)
    assert (one.matrix != other.matrix).nnz == 0 and len(one) > 3


def test_errors_are_those_of_the_replicates():
    scene, parts = shapes.scene_of(*shapes.box((1, 2, 3)))
    spread = [at.view_factors(scene, parts, samples=1 << 10, seed=k) for k in range(24)]
    factors = np.array([each.factors.toarray() for each in spread])
    errors = np.array([each.errors[:, :6].toarray() for each in spread])
    seen = errors.mean(0) > 0
    assert seen.sum() == 30
    ratio = factors.std(0, ddof=1)[seen].mean() / np.sqrt((errors**2).mean(0))[seen].mean()
    assert 0.85 < ratio < 1.15


def test_points_are_uniform_and_directions_have_the_cosine():
    soup = np.array(
        [[[0, 0, 0], [4, 0, 0], [0, 1, 0]], [[0, 0, 0], [0, 0, 1], [4, 0, 0]], [[0, 0, 0], [1, 0, 0], [2, 0, 0]]], float
    )
    scene = at.Scene.from_arrays(soup, up="z")
    rays = HemisphereRays(scene.triangles(), np.zeros(3, int), 1 << 12, 1.0, 0).of_groups(0, 1)
    assert np.bincount(rays.faces, minlength=3).tolist() == [2048, 2048, 0]
    on_floor = rays.faces == 0
    np.testing.assert_allclose(rays.origins[on_floor].mean(0), [4 / 3, 1 / 3, 0], atol=0.01)
    np.testing.assert_allclose(np.linalg.norm(rays.directions, axis=1), 1.0)
    cosines = rays.directions[on_floor, 2]
    np.testing.assert_allclose([cosines.min() > 0, cosines.mean(), (cosines**2).mean()], [1, 2 / 3, 1 / 2], atol=0.01)
    assert (rays.origins[on_floor, 2] > 0).all() and REPLICATES == 8


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"per": "wall"}, "per is 'wall'"),
        ({"per": np.full(2, -1)}, "no surface has an area"),
        ({"samples": 8}, "samples is 8; it must be a whole number from 64"),
        ({"side": "both"}, 'side is \'both\'; it must be "front" or "back"'),
        ({"seed": -1}, "seed is -1"),
    ],
)
def test_errors(arguments, message):
    scene = at.Scene.from_arrays(shapes.rectangle((0, 0, 0), (1, 0, 0), (0, 1, 0)))
    with pytest.raises(at.InputError, match=message):
        at.view_factors(scene, **arguments)


def test_a_store_has_the_factors_of_its_scene(tmp_path):
    scene = at.procedural("atrium", triangles=1000)
    at.build_store(scene, tmp_path / "a.antumbra", chunk=128)
    stored, whole = at.view_factors(tmp_path / "a.antumbra", samples=256), at.view_factors(scene, samples=256)
    assert whole.factors.nnz and (stored.factors != whole.factors).nnz == 0  # a sparse array
    assert np.array_equal(stored.sky, whole.sky)
