"""Shadow rays over terrain: the bits of trees and of brute force, in all directions and with holes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
import oracle
from antumbra.engine.sources import terrain_shadows
from antumbra.engine.sources.source_protocols import PointQuery
from antumbra.query.receivers import Receivers
from antumbra.trace.terrain.terrain_rays import terrain_tree
from strength import examples
from terrain_scenes import PLACE, rasters, scene_of

HEIGHTS = rasters(18, 21, [0.0, 0.0, 0.25, 1.0, 3.0, 9.0, np.nan])
TREE = "bsah+wide"


@pytest.fixture(autouse=True, scope="module")
def _terrain_only():
    """No tree follows, however many rays there are."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(terrain_shadows, "_RAYS_PER_TRIANGLE", 1 << 60)
        yield


def directions(random, n):
    """Directions of light, some of them along the axes and diagonals of the grid."""
    some = np.array([(1, 0, 0), (0, -1, 0), (0, 0, -1), (2, 3, 0), (-2, 3, 0), (0, 1, -1), (-2, 0, -1.0), (2, 3, 1)])
    return np.concatenate([some, random.normal(size=(n, 3)) * [1, 1, 0.3]])


@examples(60)
@given(HEIGHTS, st.integers(0, 10_000))
def test_bits_are_those_of_trees_for_distant_lights(heights, seed):
    scene, random = scene_of(heights), np.random.default_rng(seed)
    if scene is None:
        return
    low, high = scene.bounds
    cells = at.sensors_of("raster", scene)
    points = np.concatenate([cells.points[cells.covered], random.uniform(low - 4.0, high + 4.0, (30, 3))])
    lights = at.DirectionalLights(directions(random, 24))
    for normals in None, np.broadcast_to((0.0, 0.0, 1.0), points.shape):
        for facing in None, "front", "back":
            bits, trees = (
                at.visibility(scene, points, lights, normals, plan=plan, cull_faces=facing).bits
                for plan in (None, TREE)
            )
            assert (bits == trees).all()
    assert scene.engine.terrain.pyramid._tree is not None


@examples(40)
@given(HEIGHTS, st.integers(0, 10_000))
def test_bits_are_those_of_trees_between_points(heights, seed):
    scene, random = scene_of(heights), np.random.default_rng(seed)
    if scene is None:
        return
    low, high = scene.bounds
    cells = at.sensors_of("raster+0.5", scene).points
    ends = np.concatenate([cells[:: max(1, len(cells) // 20)], random.uniform(low - 3.0, high + 3.0, (30, 3))])
    lights = at.PointLights(ends)
    bits, trees = (at.visibility(scene, ends, lights, plan=plan).bits for plan in (None, TREE))
    assert (bits == trees).all()


@pytest.mark.parametrize(
    "light",
    [
        at.SphereLight((84020.0, 445970.0, 25.0), 8.0),
        at.PointLight((84020.0, 445970.0, 12.0)),
        at.AmbientOcclusion(30.0),
    ],
    ids=lambda light: type(light).__name__,
)
def test_bits_are_those_of_trees_for_other_lights(light):
    scene = at.from_raster((np.random.default_rng(0).integers(0, 40, (40, 30)) / 4.0, PLACE))
    cells = at.sensors_of("raster", scene)
    bits, trees = (at.visibility(scene, cells.points, light, cells.normals, spp=70, plan=p) for p in (None, TREE))
    assert (bits.bits == trees.bits).all() and 0.05 < bits.fraction.mean() < 0.98


def test_answers_are_those_of_brute_force():
    scene = at.from_raster((np.random.default_rng(1).integers(0, 40, (12, 15)) / 4.0, PLACE))
    low, high = scene.bounds
    ends = np.random.default_rng(2).uniform(low, high, (60, 3))
    seen = at.visibility(scene, ends, at.PointLights(ends)).seen_samples
    local = (ends - scene.origin).astype(np.float32)
    for k in range(60):
        hidden = oracle.occluded(scene.triangles().vertices, np.broadcast_to(local[k], (60, 3)).copy(), ends=local)
        others = np.arange(60) != k
        assert (seen[k, others] == ~hidden[others]).all()
    assert 300 < seen.sum() < 3300


def test_jobs_have_the_results_of_trees():
    random = np.random.default_rng(3)
    scene = at.from_raster((random.integers(0, 60, (40, 50)) / 4.0, PLACE, "EPSG:28992"))
    eye = scene.bounds.mean(0) + [0.0, 0.0, 12.0]
    seen, expected = (at.viewshed(scene, "raster+1", eye, plan=plan).table["seen"] for plan in (None, TREE))
    assert (seen == expected).all() and 0 < seen.sum() < len(seen)
    hours, expected = (at.sun_hours(scene, "raster", "2026-03-21", plan=plan)["sun_hours"] for plan in (None, TREE))
    assert (hours == expected).all() and len(np.unique(hours)) > 3


def test_a_tree_follows_once_it_pays_off_and_fits(monkeypatch):
    scene = at.from_raster((np.zeros((9, 9)), PLACE))
    monkeypatch.setattr(terrain_shadows, "_RAYS_PER_TRIANGLE", 4)
    receiver, light = Receivers.in_space([[84003.3, 445997.0, 1.0]], scene.origin), at.SphereLight((0.0, 0.0, 9.0), 1.0)

    def some(rays):
        samples = np.random.default_rng(0).uniform(-0.5, 0.5, (16, rays, 3))
        return PointQuery(receiver, [light], [samples])

    shadows = at.Engine(scene).terrain
    assert shadows.serves(some(4 * 128)) and not shadows.serves(some(1))
    monkeypatch.setattr("antumbra.engine.sources.terrain_shadows.available_memory", lambda: 1000)
    shadows = at.Engine(scene).terrain
    assert shadows.serves(some(4 * 128)) and shadows.serves(some(1))
    assert at.Engine(scene, TREE).terrain is None
    scene.update(transform=np.eye(4))
    assert not shadows.serves(some(0))
    assert at.procedural("atrium", triangles=2000).engine.terrain is None


def test_moved_terrain_is_traced_where_it_is():
    scene = at.from_raster((np.random.default_rng(0).integers(0, 40, (9, 9)) / 4.0, PLACE))
    points, light = at.sensors_of("raster+1", scene).points, at.DirectionalLight((1, 1, -0.3), angular_diameter=0.0)
    before = at.visibility(scene, points, light, spp=1).bits
    shift = np.eye(4)
    shift[2, 3] = -50.0
    scene.update(transform=shift)
    after = at.visibility(scene, points, light, spp=1).bits
    assert before.any() and not after.any()


def test_terrain_that_lets_light_pass_is_not_solid():
    scene = at.from_raster((np.random.default_rng(0).integers(0, 40, (9, 9)) / 4.0, PLACE))
    scene.set_transmittance({"terrain": 1.0})
    points, light = at.sensors_of("raster+1", scene).points, at.DirectionalLight((1, 1, -0.3), angular_diameter=0.0)
    expected = at.visibility(scene, points, light, spp=1, plan=TREE)
    assert (at.visibility(scene, points, light, spp=1).bits == expected.bits).all()
    assert scene.data.terrain is None


def test_the_pyramid_holds_the_greatest_heights():
    heights = np.random.default_rng(5).integers(0, 40, (11, 18)) / 4.0
    heights[3, 4] = np.nan
    scene = at.from_raster((heights, PLACE))
    tree = terrain_tree(scene.data.source.surface, scene.origin)
    assert tree.tops[-1] == tree.z[np.isfinite(tree.z)].max() == np.float32(tree.highest)
    squares = tree.tops[: 10 * 17].reshape(10, 17)
    corners = np.stack([tree.z[:-1, :-1], tree.z[1:, :-1], tree.z[1:, 1:], tree.z[:-1, 1:]])
    whole = ~np.isnan(corners).any(0)
    assert (squares[whole] == corners.max(0)[whole]).all()
    assert np.isneginf(squares[3, 4]) and np.isneginf(squares[2, 3])  # a hole on the diagonal takes both triangles
    assert np.isfinite(squares[2, 4]) and np.isfinite(squares[3, 3])
    assert tree.starts.tolist() == [0, 170, 215, 230, 236, 238, 239]


def test_cells_may_be_oblong():
    heights = np.random.default_rng(6).integers(0, 40, (30, 20)) / 4.0
    scene = at.from_raster((heights, (2.0, 0.0, 84000.0, 0.0, -3.0, 446000.0)))
    points = np.random.default_rng(7).uniform(*scene.bounds, (200, 3)) + [0.0, 0.0, 2.0]
    lights = at.DirectionalLights(directions(np.random.default_rng(8), 40))
    bits, trees = (at.visibility(scene, points, lights, plan=plan).bits for plan in (None, TREE))
    assert (bits == trees).all() and bits.any()
