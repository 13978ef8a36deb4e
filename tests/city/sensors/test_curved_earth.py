"""A curved earth: one lowered copy serves all observers; the drop of its points; divided faces."""

import numpy as np
import pytest

import antumbra as at
from antumbra.city.sensors.curvature_options import CurvatureOptions
from antumbra.city.sensors.curved_earth import Earth, earth_of, lowered_scene, subdivide
from antumbra.city.sensors.sensors import corners_of

RADIUS = 6_371_000.0


def rugged(seed=3, size=30_000.0, cells=25):
    """A rugged raster of 30 km."""
    heights = np.random.default_rng(seed).uniform(0.0, 60.0, (cells, cells))
    side = size / cells
    return at.from_raster((heights, (side, 0.0, 80_000.0, 0.0, -side, 460_000.0)))


def test_points_sink_by_the_square_of_their_distance():
    earth = Earth((1.0 - 0.13) / (2.0 * RADIUS), np.array([10.0, 20.0, 5.0]), 2)
    lowered = earth.lowered(np.array([[10.0, 20.0, 7.0], [10_010.0, 20.0, 7.0], [10.0, -4_980.0, 7.0]]))
    assert np.allclose(lowered[:, 2], 7.0 - 0.87 * np.array([0.0, 1e8, 25e6]) / (2.0 * RADIUS), rtol=0, atol=1e-9)


def test_one_copy_shows_every_observer_what_a_copy_around_it_shows():
    """Copies around two places differ by a shear, which keeps lines straight; only rounding may decide otherwise."""
    scene, rng = rugged(), np.random.default_rng(5)
    cells = at.sensors_of("raster+2", scene)
    eyes = rng.uniform([82_000.0, 432_000.0, 70.0], [108_000.0, 458_000.0, 120.0], (4, 3))
    found = at.viewshed(scene, cells, eyes, curvature=True, each=True, refraction=0.13).table
    drop = 0.87 / (2.0 * RADIUS)
    for k, eye in enumerate(eyes):
        own = Earth(drop, eye, 2)
        copy = lowered_scene(scene, own)
        away = own.lowered_sensors(cells).points
        seen = ~copy.occluded(np.broadcast_to(eye, away.shape), targets=away)
        assert (found[f"seen_{k + 1}"] != seen).sum() <= 2 and 50 < seen.sum() < 600
    assert (found["seen"] == sum(found[f"seen_{k}"] for k in range(1, 5))).all()


@pytest.mark.parametrize("cells, raster", [(25, False), (200, True)])
def test_a_raster_stays_one_unless_its_edges_are_long(cells, raster):
    """Edges of 1,200 m are divided, and those of 150 m are not; heights sink as points do, and holes stay."""
    scene = rugged(cells=cells)
    heights = scene.data.terrain.heights.copy()
    heights[3, 4] = np.nan
    side = scene.raster.spacing
    scene = at.from_raster((heights, (side, 0.0, 80_000.0, 0.0, -side, 460_000.0)))
    earth = Earth(0.87 / (2.0 * RADIUS), scene.bounds.mean(0), 2)
    copy = lowered_scene(scene, earth)
    assert (copy.data.terrain is not None) is raster and (copy.n_triangles == scene.n_triangles) is raster
    at_vertices = corners_of(scene).reshape(-1, 3)
    made, expected = corners_of(copy).reshape(-1, 3), earth.lowered(at_vertices)
    if raster:
        assert np.abs(made - expected).max() < 0.005  # float32 at 15 km
    assert abs(made[:, 2].min() - expected[:, 2].min()) < 0.5 and abs(made[:, 2].max() - expected[:, 2].max()) < 0.5


def test_a_scene_that_lets_light_through_is_not_bent(tmp_path):
    scene = rugged()
    (tmp_path / "trees.csv").write_text("x,y,height,radius\n95000,445000,20,6\n")
    scene = at.from_trees(tmp_path / "trees.csv", transmittance=0.2, scene=scene)
    for study in (
        lambda: at.viewshed(scene, "raster+2", [95_000.0, 440_000.0, 90.0], curvature=True),
        lambda: at.visible_share(scene, "raster+2", at.Turbine((95_000, 440_000, 60), 100, 80), curvature=True),
        lambda: earth_of(CurvatureOptions(curvature=True), scene),
    ):
        with pytest.raises(at.InputError, match=r"has alpha masks or transmittance.*leave curvature out"):
            study()
    assert earth_of(CurvatureOptions(), scene) is None


def test_divided_faces_cover_the_same_area_and_fit_each_other():
    rng = np.random.default_rng(2)
    corners = rng.uniform(-10, 10, (20, 3, 3))
    made = subdivide(corners, 3.0)
    area = lambda v: np.linalg.norm(np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0]), axis=1).sum()
    edges = np.linalg.norm(np.roll(made, -1, 1) - made, axis=2)
    assert np.isclose(area(made), area(corners)) and edges.max() <= 3.0 and len(made) > 100
    quad = np.array([[[0, 0, 0], [9, 0, 0], [9, 9, 0]], [[0, 0, 0], [9, 9, 0], [0, 30, 0]]], float)
    halves = [subdivide(face[None], 2.0).reshape(-1, 3) for face in quad]
    on_edge = [{tuple(p) for p in half if p[0] == p[1]} for half in halves]
    assert on_edge[0] == on_edge[1] and len(on_edge[0]) > 4
