"""Cell verdicts: `contains` gives the same answers with and without cells, which decide about most points."""

import numpy as np
import pytest
import trimesh

import antumbra as at
from antumbra.trace.rays import cell_verdicts
from antumbra.trace.rays.inside_votes import KNOWN, OUTSIDE, UNDECIDED, WITHIN


def ball(*, radius=1.0, at_point=(0, 0, 0), holes=0, turn=0):
    sphere = trimesh.creation.icosphere(3)
    corners = np.asarray(sphere.triangles) @ np.linalg.qr(np.random.default_rng(turn).normal(size=(3, 3)))[0]
    kept = np.random.default_rng(turn).permutation(len(corners))[holes:]
    return corners[kept] * radius + at_point


SCENES = {
    "closed": lambda: ball(),
    "nested and apart": lambda: np.concatenate(
        [ball(), ball(radius=0.5), ball(at_point=(3, 1, 0), turn=2), ball(radius=0.1, at_point=(0.2, 0.1, 0.1))]
    ),
    "drawn twice": lambda: np.concatenate([ball(), ball()[:, ::-1], ball(at_point=(3, 0, 0))]),
    "open": lambda: ball(holes=3),
    "open, with others": lambda: np.concatenate([ball(holes=40), ball(radius=0.4, turn=1), ball(at_point=(2, 1, 1))]),
    "a bowl": lambda: ball()[ball()[:, :, 0].min(1) > 0.3],
}


def hostile(scene, grid, rng):
    """Points anywhere, on borders of cells, on corners and inside faces, and beyond the bounds."""
    lower, upper = scene.bounds
    soup = scene.triangles().vertices
    steps = rng.integers(0, [grid.nx + 1, grid.ny + 1, grid.nz + 1], (1500, 3))
    borders = (grid.box[0].astype(float) + steps * grid.sides).astype(np.float32)
    faces = soup[rng.integers(len(soup), size=500)]
    on_faces = (rng.dirichlet((1, 1, 1), 500)[:, :, None] * faces).sum(1).astype(np.float32)
    near = np.concatenate([borders, on_faces, soup.reshape(-1, 3)[::7], grid.box])
    near = np.concatenate([near, np.nextafter(near, np.float32(-np.inf)), np.nextafter(near, np.float32(np.inf))])
    size = upper - lower
    anywhere = rng.uniform(lower - 0.1 * size, upper + 0.1 * size, (4000, 3))
    return np.concatenate([near.astype(float) + scene.origin, anywhere])


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("threads", [1, 3])
def test_cells_change_no_answer(name, threads, monkeypatch):
    corners, rng = SCENES[name](), np.random.default_rng(3)
    with_cells, without = (at.Scene.from_arrays(corners, up="z") for _ in range(2))
    monkeypatch.setattr(cell_verdicts, "_GRID_PAYS", 1)
    with_cells.contains([0.0, 0.0, 0.0])
    grid = with_cells.engine.source.ray_lists.bodies(0.0).cells._grid
    monkeypatch.setattr(cell_verdicts, "_GRID_PAYS", 1 << 60)
    points = hostile(with_cells, grid, rng)
    expected = without.contains(points, threads=threads)
    assert without.engine.source.ray_lists.bodies(0.0).cells._grid is None
    np.testing.assert_array_equal(with_cells.contains(points, threads=threads), expected)
    np.testing.assert_array_equal(
        np.concatenate([with_cells.contains(part) for part in np.array_split(points, 50)]), expected
    )
    codes = set(np.unique(grid.cells).tolist())
    assert {OUTSIDE, WITHIN, UNDECIDED} <= codes
    assert bool(codes & {KNOWN, KNOWN + 1}) == (without.notes != ())
    assert (grid.cells == UNDECIDED).mean() < 0.25


def test_cells_come_after_thousands_of_points_and_follow_updates():
    scene, points = at.Scene.from_arrays(ball()), np.random.default_rng(0).uniform(-2, 5, (9000, 3))
    cells = lambda: scene.engine.source.ray_lists.bodies(0.0).cells
    first = scene.contains(points)
    assert cells()._grid is None
    np.testing.assert_array_equal(scene.contains(points), first)
    assert cells()._grid is not None
    np.testing.assert_array_equal(scene.contains(points), first)
    scene.update(ball(at_point=(2, 0, 0)))
    moved = [scene.contains(points) for _ in range(3)]
    np.testing.assert_array_equal(moved[0], moved[2])
    assert cells()._grid is not None and moved[0].sum() > 0 and (moved[0] != first).any()


def test_points_beyond_float32_of_the_cells_are_decided_by_rays(monkeypatch):
    monkeypatch.setattr(cell_verdicts, "_GRID_PAYS", 1)
    corners = np.concatenate([ball(), ball(radius=1e-30)])
    points = np.random.default_rng(0).uniform(-1, 1, (500, 3))
    scene = at.Scene.from_arrays(corners)
    inside = scene.contains(points)
    np.testing.assert_array_equal(inside, scene.count_hits(points, [0, 0, 1.0], merge="surface") % 2 == 1)
    tiny = at.Scene.from_arrays(ball(radius=1e-30))
    assert tiny.contains([0.0, 0.0, 0.0]) and tiny.engine.source.ray_lists.bodies(0.0).cells._grid is None
