"""All queries count the same hits: on edges, corners, coplanar, degenerate and doubled faces, in every source."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import antumbra as at
import gis_files
import oracle
from cutout_scenes import scene_with_cutouts
from ray_cases import displaced_meets

BOX = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
BOX_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4],
     [1, 5, 7], [1, 7, 3]]
)  # fmt: skip

small = st.integers(-2, 2)
point = st.tuples(small, small, small)
SOUPS = st.lists(st.tuples(point, point, point), min_size=1, max_size=6)
RAYS = st.lists(st.tuples(point, point.filter(any)), min_size=1, max_size=8)


def assert_one_definition(scene, origins, directions, **limits):
    """Assert that all queries agree; return the hits of each ray."""
    occluded = scene.occluded(origins, directions, **limits)
    closest = scene.closest_hit(origins, directions, **limits)
    for merge in "none", "surface":
        counts = scene.count_hits(origins, directions, merge=merge, **limits)
        hits = scene.all_hits(origins, directions, merge=merge, **limits)
        np.testing.assert_array_equal(hits.counts, counts)
        assert counts.sum() == len(hits.t) == len(hits.face)
        assert (counts[~occluded] == 0).all()
        few = scene.all_hits(origins, directions, merge=merge, max_hits=1, **limits)
        np.testing.assert_array_equal(few.counts, np.minimum(counts, 1))
        if merge == "none":
            np.testing.assert_array_equal(counts > 0, occluded)
            np.testing.assert_array_equal(counts > 0, closest.face >= 0)
            first = hits.ray_offsets[:-1][occluded]
            for name in "t", "face", "u", "v":
                np.testing.assert_array_equal(getattr(hits, name)[first], getattr(closest, name)[occluded])
            every = hits
    return every


@settings(deadline=None, max_examples=80)
@given(SOUPS, RAYS, st.booleans())
def test_hostile_soups_in_memory_and_as_instances(soup, rays, doubled):
    soup = np.array(soup, float)
    soup = np.concatenate([soup, soup[:, ::-1]]) if doubled else soup
    origins, directions = (np.array(each, float) for each in zip(*rays))
    shown = soup if np.ptp(soup.reshape(-1, 3), axis=0).any() else soup + [[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]
    scenes = [
        at.Scene.from_arrays(shown),
        at.Scene.from_instances([shown], [[np.eye(4)]], instances=True),
    ]
    for scene in scenes:
        hits = assert_one_definition(scene, origins, directions)
        truth = [[oracle.meets_exactly(o, d, t)[0] != 0 for t in shown] for o, d in zip(origins, directions)]
        np.testing.assert_array_equal(hits.counts, np.sum(truth, axis=1))
        crossed = [
            sum(met and displaced_meets(o, d, t) for met, t in zip(row, shown))
            for row, o, d in zip(truth, origins, directions)
        ]
        np.testing.assert_array_equal(scene.count_hits(origins, directions, merge="surface"), crossed)
        assert_one_definition(scene, origins, directions, tmin=0.5, tmax=1.0)
        assert_one_definition(scene, origins, directions, cull_faces="front")
        assert_one_definition(scene, origins, directions, skip_face=np.zeros(len(origins), int))


def lattice_rays(low, high):
    """Rays between the points of a lattice, through edges and corners of boxes on it."""
    steps = np.linspace(low, high, 5)
    ends = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 3)
    rng = np.random.default_rng(0)
    origins, targets = ends[rng.integers(len(ends), size=(2, 400))]
    moves = (origins != targets).any(1)
    return origins[moves], (targets - origins)[moves]


@pytest.mark.parametrize(
    "faces", [BOX_FACES, np.concatenate([BOX_FACES, BOX_FACES[:, ::-1]])], ids=["once", "per side"]
)
@pytest.mark.parametrize("stored", [False, True], ids=["memory", "store"])
def test_edges_and_corners_of_a_box(faces, stored, tmp_path):
    scene = at.Scene.from_arrays(BOX, faces)
    if stored:
        at.build_store(scene, tmp_path / "a.antumbra", chunk=16)
        scene = at.load(tmp_path / "a.antumbra")
    hits = assert_one_definition(scene, *lattice_rays(-2.0, 2.0))
    assert hits.counts.max() > 4 and (hits.counts == 0).any()


def test_cutouts_and_panes():
    rng = np.random.default_rng(3)
    origins, directions = rng.uniform((-3, 0, -3), (3, 3, 3), (300, 3)), rng.normal(size=(300, 3))
    hits = assert_one_definition(scene_with_cutouts(), origins, directions)
    assert len(hits.t) > 50
    panes = at.Scene.from_arrays(BOX, BOX_FACES)
    panes.set_transmittance({"arrays": 0.7})
    assert_one_definition(panes, *lattice_rays(-2.0, 2.0))


def test_rasters_of_heights():
    scene = at.from_raster((gis_files.hills(), gis_files.PLACE))
    low, high = scene.bounds
    ends = np.random.default_rng(0).uniform(low, high, (2, 200, 3))
    assert 20 < (assert_one_definition(scene, ends[0], ends[1] - ends[0]).counts > 0).sum() < 180


def test_drop_ins_agree_with_each_other_and_with_the_scene():
    trimesh = pytest.importorskip("trimesh")
    from antumbra.integrations.open3d import RaycastingScene

    origins, directions = lattice_rays(-2.0, 2.0)
    for faces in BOX_FACES, np.concatenate([BOX_FACES, BOX_FACES[:, ::-1]]):
        there = at.Scene.from_arrays(BOX, faces).occluded(origins, directions)
        mesh = at.trimesh_ray(trimesh.Trimesh(BOX, faces, process=False))
        np.testing.assert_array_equal(mesh.intersects_any(origins, directions), there)
        np.testing.assert_array_equal(mesh.intersects_first(origins, directions) >= 0, there)
        found = mesh.intersects_id(origins, directions)[1]
        np.testing.assert_array_equal(np.bincount(found, minlength=len(there)) > 0, there)
        open3d = RaycastingScene()
        open3d.add_triangles(BOX, faces)
        rays = np.concatenate([origins, directions], axis=1)
        np.testing.assert_array_equal(np.asarray(open3d.test_occlusions(rays)), there)
        np.testing.assert_array_equal(np.isfinite(np.asarray(open3d.cast_rays(rays)["t_hit"])), there)
        splits = np.asarray(open3d.list_intersections(rays)["ray_splits"]).astype(int)
        np.testing.assert_array_equal(np.diff(splits) > 0, there)
        points = np.random.default_rng(0).uniform(-1.5, 1.5, (400, 3))
        inside = (np.abs(points) <= 1).all(1)
        assert 50 < inside.sum() < 350
        np.testing.assert_array_equal(mesh.contains_points(points), inside)
        np.testing.assert_array_equal(np.asarray(open3d.compute_occupancy(points)) > 0.5, inside)
