"""Jobs in rooms whose faces exist twice, once per side: what is inside does not depend on the outer copy."""

import numpy as np
import pytest

import antumbra as at
from antumbra.city.sensors.surface_groups import surface_groups
from antumbra.datasets.random_views import sampling_region
from baked_files import Glb, scene_file
from double_rooms import CEILING, FLOOR, ORDERS, OUTSIDE, SIZE, TURNS, double_room, parallel_rectangles, single_room

CASES = [(order, turn) for order in ORDERS for turn in TURNS]


def _scene(room, without=None):
    """The room, without a pair of walls."""
    return at.Scene.from_arrays(room.vertices, room.faces[room.walls != without], up="z")


def _open_to_the_sky(room):
    """The room without the ceiling and its outer copy."""
    above = (room.corners[:, :, 2] == SIZE[2]).all(1)
    return room._replace(faces=room.faces[~above], walls=room.walls[~above])


# --- View factors -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order, turn", CASES)
def test_form_factors_inside_a_double_room_are_those_of_a_single_one(order, turn):
    room, alone = double_room(order, turn), single_room(turn)
    whole = at.view_factors(_scene(alone), alone.walls, samples=4096)
    double = at.view_factors(_scene(room), room.walls, samples=4096)
    got = double.matrix.toarray()
    exact = parallel_rectangles(SIZE[0], SIZE[1], SIZE[2])
    assert got[FLOOR, CEILING] == pytest.approx(exact, abs=5 * double.errors.toarray()[FLOOR, CEILING])
    assert (got[:, :6].sum(1) == 1.0).all() and (got[:, 6:] == 0.0).all()
    if order == "inner first":  # the rays of the same points
        np.testing.assert_array_equal(got, whole.matrix.toarray())


@pytest.mark.parametrize("order, turn", CASES)
def test_backs_of_an_outer_copy_exchange_heat_through_the_inner_one(order, turn):
    """The side that radiates also receives: the backs of the outer copy, although inner faces coincide with them."""
    room = double_room(order, turn)
    centres = room.corners.mean(1) - room.vertices.mean(0)
    wall = np.argmax(np.einsum("ij,kj->ik", centres, _outward(turn)), axis=1)
    outer = np.where(room.walls == OUTSIDE, wall, OUTSIDE)
    got = at.view_factors(_scene(room), outer, samples=4096, side="back")
    exact = parallel_rectangles(SIZE[0], SIZE[1], SIZE[2])
    assert got.matrix.toarray()[FLOOR, CEILING] == pytest.approx(exact, abs=5 * got.errors.toarray()[FLOOR, CEILING])
    assert (got.matrix.toarray()[:, :6].sum(1) == 1.0).all()


def _outward(turn):
    """(6, 3): the outward normal of each wall, over the distance from the middle."""
    alone = single_room(turn)
    centres = alone.corners.reshape(6, -1, 3).mean(1) - alone.vertices.mean(0)
    return centres / (centres**2).sum(1, keepdims=True)


@pytest.mark.parametrize("order", ORDERS)
def test_planar_parts_of_a_double_room_are_twelve_sides(order):
    room = double_room(order, 27.3)
    groups = surface_groups(_scene(room), "surface")
    assert len(groups.names) == 12 and (np.bincount(groups.of_face) == 2).all()
    for wall in range(6):
        assert len(set(groups.of_face[room.walls == wall])) == 1


# --- Receivers on coincident faces ------------------------------------------------------------------------------------


def _points(turn):
    """(points, normals) on the inner faces."""
    corners = single_room(turn).corners
    weights = np.random.default_rng(3).dirichlet((1, 1, 1), (len(corners), 20))
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    points = np.einsum("fpk,fkc->fpc", weights, corners)
    return points.reshape(-1, 3), np.repeat(across / np.linalg.norm(across, axis=1, keepdims=True), 20, axis=0)


@pytest.mark.parametrize("order, turn", CASES)
def test_the_outer_copy_blocks_no_light_of_the_inner_faces(order, turn):
    points, normals = _points(turn)
    middle = single_room(turn).vertices.mean(0)
    for light in (at.PointLight(tuple(middle + 0.3)), at.AmbientOcclusion(1.0, spp=64)):
        answers = [
            at.visibility(_scene(room), points, light, normals=normals, spp=16).bits
            for room in (single_room(turn), double_room(order, turn))
        ]
        np.testing.assert_array_equal(*answers)
    assert answers[0].any()


@pytest.mark.parametrize("order, turn", CASES)
def test_sensors_on_inner_faces_get_the_sun_of_a_single_room(order, turn):
    points, normals = _points(turn)
    sensors = at.point_sensors(points, normals)
    hours = [
        at.sun_hours(_scene(_open_to_the_sky(room)), sensors, "2026-06-21", place=at.Place(52.0, 4.0))
        for room in (single_room(turn), double_room(order, turn))
    ]
    single, double = (table["sun_hours"] for table in hours)
    np.testing.assert_array_equal(single, double)
    assert 0.0 < single.mean() < single.max()


@pytest.mark.parametrize("order", ORDERS)
def test_line_of_sight_is_blocked_by_the_side_that_it_meets(order):
    room = double_room(order, 27.3)
    middle = room.vertices.mean(0)
    away = np.random.default_rng(1).normal(size=(50, 3)) * 20
    outwards = at.line_of_sight(_scene(room), middle, middle + away)
    inwards = at.line_of_sight(_scene(room), middle + away, middle)
    assert not outwards.visible.any() and (room.walls[outwards.face] != OUTSIDE).all()
    assert (room.walls[inwards.face] == OUTSIDE).all()


@pytest.mark.parametrize("order", ORDERS)
def test_a_camera_of_a_data_set_is_not_taken_to_be_inside_a_wall(order):
    room = double_room(order, 27.3)
    region = sampling_region(_scene(room), 0.0, None)
    assert not region.walled(room.vertices.mean(0), 0.1)


# --- Pictures and bakes -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order, turn", CASES)
def test_pictures_have_the_colours_and_normals_of_the_visible_side(order, turn):
    room = double_room(order, turn)
    colours = np.where((room.walls == OUTSIDE)[:, None], (1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    scene = at.Scene.from_arrays(room.vertices, room.faces, colours=colours, up="z")
    middle = room.vertices.mean(0)
    inside = at.Camera(middle, middle + (1, 0.3, 0.1), (0, 0, 1), 100, width=24, height=18)
    outside = at.Camera(middle + (5, 3, 2), middle, (0, 0, 1), width=24, height=18)
    for camera, is_outside in ((inside, False), (outside, True)):
        face = at.render(scene, camera, at.PointLight(tuple(camera.position)), spp=1).gbuffer.face
        assert ((room.walls[face[face >= 0]] == OUTSIDE) == is_outside).all() and (face >= 0).mean() > 0.1
        image = at.render(scene, camera, at.PointLight(tuple(camera.position)), spp=1).image[face >= 0]
        assert (image[:, 0 if is_outside else 2] > image[:, 2 if is_outside else 0]).all()


@pytest.mark.parametrize("order, turn", CASES)
def test_pictures_inside_a_double_room_are_those_of_a_single_one(order, turn):
    middle = single_room(turn).vertices.mean(0)
    camera = at.Camera(middle, middle + (1, 0.3, 0.1), (0, 0, 1), 100, width=32, height=24)
    lights = [at.PointLight(tuple(middle + 0.3)), at.AmbientOcclusion(1.0)]
    single, double = (
        at.render(_scene(r), camera, lights, spp=8) for r in (single_room(turn), double_room(order, turn))
    )
    for mine, other in zip((*double.bits, double.image), (*single.bits, single.image)):
        np.testing.assert_array_equal(mine, other)
    assert single.bits[1].any()


def _baked(folder, room, *arguments, **options):
    """Values at the three vertices of each face of a room, (n, 3)."""
    upright = room.corners[..., [0, 2, 1]].astype(np.float32)[:, ::-1].reshape(-1, 3)  # glTF has +y up
    rows = np.arange(len(upright), dtype=np.uint32).reshape(-1, 3)
    at.bake(scene_file(folder, (upright, rows)), folder / "out.glb", *arguments, attribute="_VALUE", **options)
    return Glb(folder / "out.glb").attribute("_VALUE")[:, 0].reshape(-1, 3)


@pytest.mark.parametrize("order, turn", CASES)
def test_bakes_of_inner_faces_do_not_depend_on_the_outer_copy(order, turn, tmp_path):
    room, alone = double_room(order, turn), single_room(turn)
    inner = room.walls != OUTSIDE
    assert (_baked(tmp_path, room, spp=64)[inner] == 0.0).all()
    sun = at.DirectionalLight((0.4, -1.0, 0.3), 0.0)
    room, alone = _open_to_the_sky(room), _open_to_the_sky(alone)
    double, single = (_baked(tmp_path, each, "shadow", lights=sun) for each in (room, alone))
    found = [_lit_places(each, values) for each, values in ((room, double), (alone, single))]
    assert found[0] == found[1] and 0 < len(found[0]) < 20


def _lit_places(room, values):
    """The (wall, corner) of the vertices of inner faces with a value of 1."""
    rows = np.flatnonzero(room.walls != OUTSIDE)
    vertices, lit = room.faces[rows, ::-1], values[rows] == 1.0  # in the order in which `_baked` writes them
    return set(zip(np.repeat(room.walls[rows], 3)[lit.ravel()].tolist(), vertices[lit].tolist()))
