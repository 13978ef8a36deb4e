"""Frames made with Embree see the same as ours, except where rounding decides."""

import numpy as np
import pytest

import antumbra as at

pytest.importorskip("embreex", reason="Embree is not installed: pip install 'antumbra[peers]'")

from peers import embree
from peers.embree_frames import Primary, Shadow, light_points, primary, shadows

SPP = 6  # no multiple of any packet's width
LIGHT = at.QuadLight((-1, 3.5, -1), (2, 0, 0), (0, 0, 2))


@pytest.fixture(scope="module")
def made():
    """(scene, camera, our frame) of a picture whose size is no multiple of a block."""
    scene = at.procedural("atrium", triangles=2000)
    camera = scene.cameras[0].resized(45, 31)
    return scene, camera, at.render(scene, camera, [LIGHT], spp=SPP)


@pytest.mark.parametrize(
    "eye, lamp",
    [
        (Primary(1, False), Shadow(1, "samples", False)),
        (Primary(16, True), Shadow(16, "pixels", True)),
        (Primary(8, False), Shadow(4, "samples", True)),
        (Primary(4, True), Shadow(8, "pixels", False)),
    ],
)
def test_every_way_gives_our_picture(made, eye, lamp):
    scene, camera, ours = made
    triangles = scene.triangles()
    with embree.Device(2) as device, embree.EmbreeScene(device, triangles.vertices, flags=embree.ROBUST) as built:
        hits = primary(built, triangles, camera.rays(triangles.origin), eye, 2)
        bits = shadows(built, hits, light_points(LIGHT, triangles.origin, SPP), lamp, 2)
    same = hits.gbuffer.face == ours.gbuffer.face
    assert same.mean() > 0.99 and bits.shape == ours.bits[0].shape
    np.testing.assert_allclose(hits.gbuffer.depth[same], ours.gbuffer.depth[same], rtol=1e-4)
    different = np.bitwise_count(bits ^ ours.bits[0])[same].sum()
    assert 0 < np.bitwise_count(bits).sum() < SPP * bits.size and different <= 0.002 * SPP * bits.size


def test_building_again():
    corners = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], np.float32)
    scene = at.Scene.from_arrays(corners)
    camera = at.Camera((0.2, 0.2, 2), (0.2, 0.2, 0), width=1, height=1)
    rays, triangles = camera.rays(scene.origin), scene.triangles()
    with embree.Device(1) as device:
        for flags, refit in ((0, False), (embree.DYNAMIC, True)):
            with embree.EmbreeScene(device, triangles.vertices, flags=flags) as built:
                seen = []
                for shift in (0, 5, 0):
                    moved = triangles._replace(vertices=triangles.vertices + np.float32(shift))
                    built.fill(moved.vertices)
                    built.build_again(refit)
                    seen.append(int(primary(built, moved, rays, Primary(1, False), 1).gbuffer.face[0, 0]))
                assert seen == [0, -1, 0] and built.build_seconds > 0.0
            with embree.EmbreeScene(device, triangles.vertices) as built, pytest.raises(ValueError, match="bytes"):
                built.fill(np.zeros((2, 3, 3), np.float32))


def test_lights_that_look_different_from_everywhere_are_refused():
    with pytest.raises(NotImplementedError):
        light_points(at.SphereLight((0, 0, 0), 1.0), np.zeros(3), 4)
