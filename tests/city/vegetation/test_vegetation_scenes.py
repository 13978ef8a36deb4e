"""Trees: closed crowns whose share of the light is that of the whole crown, alone and added to scenes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
from antumbra.city.vegetation.crowns import SHAPES, TREE_TYPE
from antumbra.city.vegetation.vegetation_scenes import from_trees
from antumbra.scene.alpha_masks import find_cutouts, join_cutouts
from strength import examples

gpd = pytest.importorskip("geopandas")
shapely = pytest.importorskip("shapely")

DOWN = at.DirectionalLight([0.0, 0.0, -1.0])
LEAVES = [0.75, 0.75, 0.625, 0.5, 0.25, 0.25, 0.25, 0.25, 0.5, 0.5, 0.625, 0.75]


def trees(places=((0.0, 0.0),), height=10.0, radius=3.0, crs=None, **columns):
    data = {"height": np.full(len(places), height), "radius": np.full(len(places), radius), **columns}
    return gpd.GeoDataFrame(data, geometry=shapely.points(np.asarray(places, float)), crs=crs)


def ground(height=1.0, up="z"):
    corners = np.array([[-50.0, -50, height], [50, -50, height], [50, 50, height], [-50, 50, height]])
    if up == "y":
        corners = corners[:, [0, 2, 1]] * [1, 1, -1]
    return at.Scene.from_arrays(corners, np.array([[0, 1, 2], [0, 2, 3]]), up=up, name="ground")


def arriving(scene, points, light=DOWN):
    return at.visibility(scene, np.asarray(points, float), light).fraction


def volumes(scene):
    """The signed volume of each object, and whether each of its edges has two faces, one in each direction."""
    corners = scene.triangles().vertices.astype(np.float64)
    volume = np.bincount(scene.object_of_face, np.linalg.det(corners) / 6.0)
    edges = np.concatenate([corners[:, [k, (k + 1) % 3]] for k in range(3)]).tolist()
    there = sorted((tuple(a), tuple(b)) for a, b in edges)
    back = sorted((tuple(b), tuple(a)) for a, b in edges)
    return volume, there == back


# --- Shapes -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape, triangles", [("ellipsoid", 48), ("cone", 14)])
@pytest.mark.parametrize("up", ["y", "z"])
def test_crowns_and_trunks_are_closed_and_face_outwards(shape, triangles, up):
    scene = from_trees(trees([(0, 0), (9, 5)]), shape=shape, scene=ground(up=up))
    assert scene.n_triangles == 2 + 2 * (triangles + 20)
    alone = from_trees(trees([(0, 0), (9, 5)]), shape=shape)
    volume, closed = volumes(alone)
    assert closed and (volume > 0).all()
    bounds = alone.bounds
    assert bounds[0, 2] == 0.0 and bounds[1, 2] == 10.0
    assert [each.type for each in alone.objects] == [TREE_TYPE] * 2
    assert [each.name for each in alone.objects] == ["tree 0", "tree 1"]


@pytest.mark.parametrize("shape", SHAPES)
def test_the_widest_section_has_the_area_of_the_circle(shape):
    scene = from_trees(trees(radius=2.5), shape=shape, trunk_radius=0)
    corners = scene.triangles().vertices.astype(np.float64)
    u, v = corners[:, 1, :2] - corners[:, 0, :2], corners[:, 2, :2] - corners[:, 0, :2]
    facing_up = (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) / 2.0
    assert np.isclose(facing_up[facing_up > 0].sum(), np.pi * 2.5**2, rtol=1e-6)
    volume, _ = volumes(scene)
    height = 7.5
    exact = np.pi * 2.5**2 * height * (2 / 3 if shape == "ellipsoid" else 1 / 3)
    assert 0.8 * exact < volume[0] <= exact * (1 + 1e-6)


def test_a_cone_with_its_base_on_the_ground_and_a_tree_without_a_trunk():
    scene = from_trees(trees(), shape="cone", crown_base=0, trunk_radius=0)
    assert scene.n_triangles == 14 and scene.bounds[:, 2].tolist() == [0.0, 10.0]


# --- The light through crowns -----------------------------------------------------------------------------------------


@examples(15)
@given(share=st.floats(0.01, 1.0), shape=st.sampled_from(SHAPES), x=st.floats(-1.5, 1.5), y=st.floats(-1.5, 1.5))
def test_a_crown_lets_its_share_pass_wherever_light_crosses_it(share, shape, x, y):
    scene = from_trees(trees(), transmittance=share, shape=shape, trunk_radius=0)
    light = at.DirectionalLight([-x / 50, -y / 70, -1.0])
    below, beside = arriving(scene, [[x, y, 0.5], [20.0, 0, 0]], light)
    assert np.isclose(below, share, rtol=1e-6) and beside == 1.0


def test_a_point_inside_a_crown_is_behind_one_surface_and_a_row_of_crowns_multiplies():
    scene = from_trees(trees([(0, 0), (8, 0), (16, 0)]), transmittance=0.25, trunk_radius=0)
    inside, outside = arriving(scene, [[0.0, 0, 6], [0.3, 0.2, 0.5]])
    assert np.isclose(inside, 0.5, rtol=1e-6) and np.isclose(outside, 0.25, rtol=1e-6)
    along = at.DirectionalLight([-1.0, 0.001, 0.002])
    assert np.allclose(arriving(scene, [[-9.0, 0.1, 6]], along), 0.25**3, rtol=1e-6)
    near = from_trees(trees([(0, 0), (2, 0)]), transmittance=0.25, trunk_radius=0)  # they overlap
    assert np.allclose(arriving(near, [[1.0, 0.2, 0.5]]), 0.25**2, rtol=1e-6)


def test_crowns_block_all_light_by_default_and_trunks_always():
    assert arriving(from_trees(trees(), trunk_radius=0), [[0.5, 0.5, 0.5], [9, 9, 0]]).tolist() == [0.0, 1.0]
    clear = from_trees(trees(), transmittance=1.0)
    level = at.DirectionalLight([-1.0, 0.0, 0.0])
    trunk, beside = arriving(clear, [[-5.0, 0.05, 1.0], [-5.0, 2.0, 1.0]], level)
    assert (trunk, beside) == (0.0, 1.0)


def test_colours_pass_on_their_own():
    scene = from_trees(trees(), transmittance=[0.04, 0.36, 0.16], trunk_radius=0)
    cutouts = scene.data.cutouts
    depths = cutouts.depths[cutouts.rows[cutouts.mask[0]], :3]
    assert np.allclose((0.5 ** (depths / 2**24)) ** 2, [0.04, 0.36, 0.16], rtol=1e-6)


def test_months_and_their_mean():
    """At the equator at noon, the sun is within 24 degrees of the zenith; without a date, the mean share counts."""
    scene = from_trees(trees(radius=20.0), transmittance=LEAVES, trunk_radius=0, scene=ground())
    place = at.Place(0.0, 0.0, timezone="UTC")
    table = at.sun_hours(scene, [[0.0, 0, 1.2]], "2026-01-15,2026-07-15", place=place, step=1440, by=["month"])
    assert np.isclose(table["hours_jan"][0], 24 * 0.75, rtol=1e-6)
    assert np.isclose(table["hours_jul"][0], 24 * 0.25, rtol=1e-6)
    assert np.allclose(arriving(scene, [[0.0, 0, 1.2]]), np.mean(LEAVES), rtol=1e-6)


def test_cameras_see_crowns_that_block_at_least_half():
    """Two surfaces with the root of the share would each block less than half of the light."""
    for share, visible in (0.45, True), (0.55, False):
        scene = from_trees(trees(), transmittance=share, trunk_radius=0)
        hit = scene.closest_hit([[0.1, 0.2, 20.0]], [0.0, 0.0, -1.0])
        assert bool(hit.mask[0]) == visible == bool(scene.occluded([[0.1, 0.2, 20.0]], [0.0, 0.0, -1.0])[0])


# --- Trees in scenes --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("up", ["y", "z"])
def test_trees_stand_on_the_highest_surface_of_the_scene(up):
    scene = ground(4.0, up)
    planted = from_trees(trees([(3, 7)]), scene=scene)
    axis, sign = ("yz".index(up) + 1), 1.0 if up == "z" else -1.0
    corners = planted.triangles().vertices[planted.object_of_face == 1] + planted.origin
    assert corners[..., axis].min() == 4.0 and corners[..., axis].max() == 14.0
    middle = (corners.min((0, 1)) + corners.max((0, 1))) / 2
    assert np.allclose(middle[[0, 3 - axis]], [3.0, 7.0 * sign], atol=1e-5)
    assert scene.n_triangles == 2 and planted.name == "ground"
    assert (planted.triangles().vertices[:2] + planted.origin == scene.triangles().vertices + scene.origin).all()


def test_transmittances_of_the_scene_stay():
    scene = ground(20.0)
    scene.set_transmittance({"ground": 0.5})
    planted = from_trees(trees(), transmittance=0.25, scene=scene, base=0.0, trunk_radius=0)
    assert np.allclose(arriving(planted, [[0.2, 0.1, 0.5], [30, 30, 0.5]]), [0.125, 0.5], rtol=1e-6)
    again = from_trees(trees(), transmittance=0.25, scene=scene, base=0.0, trunk_radius=0)
    again.set_transmittance({"crown": 0.5})  # of whole crowns; the shares of all others start anew
    assert np.allclose(arriving(again, [[0.2, 0.1, 25.0], [0.2, 0.1, 0.5]]), [1.0, 0.0], rtol=1e-6)
    solid = from_trees(trees(), scene=ground(), trunk_radius=0)
    assert arriving(solid, [[0.2, 0.1, 1.5], [30, 30, 1.5]]).tolist() == [0.0, 1.0]


def test_joined_cutouts_are_those_of_the_joined_scene():
    low, high = from_trees(trees(), transmittance=LEAVES), from_trees(trees([(30, 0)]), transmittance=[0.1, 0.2, 0.3])
    both = join_cutouts([(each.data.cutouts, each.n_triangles) for each in (low, high)])
    joined = from_trees(trees([(30, 0)]), transmittance=[0.1, 0.2, 0.3], scene=low, base=0.0)
    same = find_cutouts(joined.appearance)
    assert both is not None and same is not None
    assert (both.solid == same.solid).all() and (both.faces == same.faces).all() and (both.uv == same.uv).all()
    for each in both, same:
        assert len(each.months) == 12
    of = [each.depths[each.rows[each.mask]] for each in (both, same)]
    assert (of[0] == of[1]).all()
    of = [each.months[:, each.rows[each.mask]] for each in (both, same)]
    assert (of[0] == of[1]).all() and len(np.unique(of[0])) > 5
    assert join_cutouts([(None, 3), (None, 4)]) is None


def test_the_moved_ground_stays_where_it_is():
    scene = ground()
    move = np.eye(4)
    move[2, 3] = 2.0
    scene.update(transform=move)
    assert from_trees(trees(), scene=scene).bounds[:, 2].tolist() == [3.0, 13.0]
