"""What lies in a closed box, such as a sky box, is shown from inside the box, in pictures of any size."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

import antumbra as at
from antumbra.engine.default_view import _hull_planes, innermost_box
from antumbra.engine.primary_visibility import primary_visibility
from antumbra.engine.scene_views import ViewsInMemory
from antumbra.scene.default_picture import KINDS
from scene.test_scene_bounds_views import block, blocks

SIZES = (64, 64), (1024, 1024), (400, 1000), (1600, 200)
MAP = np.concatenate([blocks(200, (40, 40, 30)), block((-40, -1, -30), (40, 0, 30))])
BOXES = {
    "far": ((-500, -500, -500), (500, 500, 500)),
    "around": ((-80, -40, -80), (80, 80, 80)),
    "tight": ((-42, -2, -32), (42, 10, 32)),
    "tower": ((-45, -5, -35), (45, 400, 35)),
}


def divided(faces, times):
    """Each face as 4^times faces."""
    for _ in range(times):
        a, b, c = np.moveaxis(faces, 1, 0)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        faces = np.concatenate([np.stack(t, 1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))])
    return faces


def turned(faces):
    """Turned by 30 degrees about the up axis."""
    c, s = np.cos(np.pi / 6), np.sin(np.pi / 6)
    return faces @ np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]).T


def traced(scene, camera):
    return at.render(scene, camera, at.PointLight(camera.position), spp=1, plan="bsah+single").gbuffer.face


def assert_shows(scene, is_content, box, size, kind="perspective", least=0.03):
    """Check that a default picture is made in the box, and shows enough of the content."""
    camera = scene.default_camera(*size, kind)
    small = camera.resized(*(np.array(size) * 64 // min(size)))
    face = primary_visibility(scene.triangles(), small, None).face if kind == "perspective" else traced(scene, small)
    shown = is_content[face] & (face >= 0)
    assert shown.mean() > least, (size, kind, shown.mean())
    if kind == "perspective":
        assert (camera.position > box[0]).all() and (camera.position < box[1]).all()


@pytest.mark.parametrize("times, inward", [(0, True), (0, False), (3, False)], ids=["inward", "outward", "divided"])
@pytest.mark.parametrize("name", BOXES)
def test_a_map_in_a_sky_box(name, times, inward):
    box = divided(block(*BOXES[name], inward=inward), times)
    scene = at.Scene.from_arrays(np.concatenate([box, MAP]))
    is_content = np.arange(scene.n_triangles) >= len(box)
    for size in SIZES:
        assert_shows(scene, is_content, np.array(BOXES[name]), size)
    places = np.array([scene.default_camera(*size).position for size in SIZES])
    assert (places == places[0]).all()  # the picture's size chooses no other place
    lamp, _ = scene.default_lights()  # the sun is outside
    assert isinstance(lamp, at.SphereLight)
    assert (np.abs(lamp.center - np.mean(BOXES[name], 0)) + lamp.radius < np.ptp(BOXES[name], 0) / 2).all()


@pytest.mark.parametrize("few", [True, False], ids=["few", "many"])
@pytest.mark.parametrize("up", ["y", "z"])
def test_other_maps_and_boxes(up, few):
    """Turned, with +Z up, and two boxes in each other, around a map of few or of many triangles."""
    inner = MAP[:120] if few else np.concatenate([blocks(2500, (40, 40, 30)), MAP])
    outer = [block((-90, -50, -90), (90, 90, 90)), block((-80, -40, -80), (80, 80, 80), inward=True)]
    soup = turned(np.concatenate([*outer, inner]))
    soup = soup if up == "y" else soup[..., [0, 2, 1]] * (1, -1, 1)
    scene = at.Scene.from_arrays(soup, up=up)
    is_content = np.arange(len(soup)) >= 24
    for kind in KINDS if few else KINDS[:1]:
        for size in SIZES[::2][: 1 + (kind == "perspective")]:
            assert_shows(scene, is_content, scene.bounds, size, kind, 3e-4 if few else 0.03)
    wrapping = innermost_box(ViewsInMemory(scene.triangles()))
    assert len(wrapping.planes) == 6 and wrapping.content.face_id.tolist() == list(range(24, len(soup)))


def test_what_is_no_closed_box_is_not_opened():
    box = block((-80, -40, -80), (80, 80, 80), inward=True)
    open_above = box[np.abs(box[..., 1] - 80).max(1) > 0]
    alone = block((-1, -1, -1), (1, 1, 1))
    protruding = np.concatenate([block((-42, -2, -32), (42, 1, 32)), MAP])
    corners = [at.Scene.from_arrays(np.concatenate([open_above, MAP])), at.Scene.from_arrays(alone)]
    corners += [at.Scene.from_arrays(protruding), at.Scene.from_arrays(MAP), at.procedural("city", triangles=5000)]
    corners += [at.Scene.from_arrays(np.concatenate([alone, [alone[0] * 0.5]]))]  # a face inside is no content
    assert [innermost_box(ViewsInMemory(scene.triangles())) for scene in corners] == [None] * len(corners)
    assert all(scene.view.room is None for scene in corners[1:])


def test_a_moving_part_that_leaves_its_box_is_shown_from_outside(tmp_path):
    from gltf_files import Gltf

    made = Gltf()
    made.node(mesh=made.mesh(made.primitive(block((-2, -2, -2), (2, 2, 2)).reshape(-1, 3).astype(np.float32))))
    small = block((-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)).reshape(-1, 3).astype(np.float32)
    moving = made.node(mesh=made.mesh(made.primitive(small)))
    made.animate(moving, "translation", [0, 1], [[0, 0, 0], [0, 5, 0]])
    scene = at.load(made.write(tmp_path))
    assert scene.view.room is None and innermost_box(ViewsInMemory(scene.triangles())) is not None


@pytest.mark.parametrize("n", [4, 6, 12, 17])
def test_planes_of_closed_hulls_are_those_of_scipy(n):
    random = np.random.default_rng(n)
    points = random.normal(size=(n, 3))
    hull = ConvexHull(points / np.linalg.norm(points, axis=1, keepdims=True))
    faces = hull.points[hull.simplices].astype(np.float32)
    faces[::2] = faces[::2, ::-1]  # half of them face inward
    inside = 0.2 * faces + 0.8 * hull.points.mean(0)
    planes = _hull_planes(np.concatenate([divided(faces, 2), inside]))
    assert 4 <= len(planes) == len(hull.equations) <= 32
    nearest = np.abs(hull.equations[:, None] - planes[:, :4]).max(2)
    assert (nearest.min(1) < 1e-5).all()
    areas = np.linalg.norm(np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0]), axis=1) / 2
    np.testing.assert_allclose(planes[nearest.argmin(1), 4], areas, rtol=1e-4)


def test_facets_beside_a_hole_reach_beyond_it():
    tube = np.array([face for face in block((-1, -1, -1), (1, 1, 1)) if np.ptp(face[:, 1]) > 0])
    assert (_hull_planes(tube)[:, 4] > 8).all() and len(_hull_planes(tube)) == 4
    ball = divided(divided(block((-1, -1, -1), (1, 1, 1)), 2), 1)
    ball /= np.linalg.norm(ball, axis=2, keepdims=True)
    assert _hull_planes(ball) is None  # too many planes
    assert _hull_planes(tube * 0.0) is None
