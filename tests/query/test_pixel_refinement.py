"""Adaptive sampling: the refined pixels, the values of a finer frame there, and edges as means of sub-pixels."""

import numpy as np
import pytest

import antumbra as at
from antumbra.picture.renderer import Renderer
from antumbra.query.light_samples import light_samples
from antumbra.query.pixel_refinement import (
    OFFSETS,
    block_copies,
    block_means,
    edges,
    finer_samples,
    penumbra,
    subpixel_gbuffer,
)
from antumbra.query.surface_links import picture_surfaces

W, H = 64, 48


@pytest.fixture(scope="module")
def atrium():
    return at.procedural("atrium", triangles=5000)


@pytest.fixture(scope="module")
def camera(atrium):
    return atrium.cameras[0].resized(W, H)


def _seen(frame, camera):
    return picture_surfaces(frame.gbuffer, camera.rays(frame.gbuffer.origin))


def test_refined_visibility_is_that_of_a_finer_frame(atrium, camera):
    lights = [*atrium.lights, at.SphereLight((1, 6, -1), 0.4)]
    coarse, fine, refined = (at.render(atrium, camera, lights, **k) for k in ({}, {"spp": 64}, {"adaptive": 64}))
    seen, changed = _seen(coarse, camera), np.zeros((H, W), bool)
    for i in range(2):
        np.testing.assert_array_equal(refined.bits[i], coarse.bits[i])
        where = penumbra(seen, np.bitwise_count(coarse.bits[i]).sum(-1), 16)
        assert 0.02 < where.mean() < 0.9
        expected = np.where(where, fine.visibility[i], coarse.visibility[i])
        np.testing.assert_array_equal(refined.visibility[i], expected)
        assert (refined.visibility[i] != coarse.visibility[i]).any()
        changed |= where
    np.testing.assert_array_equal(refined.refined, changed | edges(seen, atrium.colours))
    inside = changed & ~edges(seen, atrium.colours)
    assert inside.any() and coarse.refined is None


def test_rays_and_counters_are_of_all_that_was_asked(atrium, camera):
    frame = at.render(atrium, camera, atrium.lights, adaptive=64, counters=True)
    seen = _seen(frame, camera)
    first = np.count_nonzero(frame.gbuffer.face >= 0) * 16
    again = np.count_nonzero(penumbra(seen, np.bitwise_count(frame.bits[0]).sum(-1), 16)) * 64
    edge = np.count_nonzero(edges(seen, atrium.colours)) * 64
    assert frame.rays == frame.counters["rays"]
    assert first + again + 0.5 * edge < frame.rays <= first + again + edge


@pytest.mark.parametrize("plain", [{"threads": 1}, {"gbuffer": "rays"}])
def test_it_does_not_matter_how(atrium, camera, plain):
    a, b = (at.render(atrium, camera, atrium.lights, adaptive=32, filter=True, **k) for k in ({"threads": 3}, plain))
    np.testing.assert_array_equal(a.image, b.image)
    np.testing.assert_array_equal(a.visibility[0], b.visibility[0])
    np.testing.assert_array_equal(a.refined, b.refined)
    assert a.rays == b.rays


def _square(z, half, colour):
    corners = np.array([[-half, -half, z], [half, -half, z], [half, half, z], [-half, half, z]], float)
    return corners, np.array([[0, 1, 2], [0, 2, 3]]), np.tile(np.float32(colour), (2, 1))


def _scene(*squares):
    offsets = np.cumsum([0, *(len(s[0]) for s in squares)])
    faces = np.concatenate([s[1] + o for s, o in zip(squares, offsets)])
    return at.Scene.from_arrays(np.concatenate([s[0] for s in squares]), faces, np.concatenate([s[2] for s in squares]))


SUN = at.DirectionalLight((0, 0, -1), 0.0)  # from behind the camera, so that no shadow is visible


def test_edges_of_a_square_before_another():
    scene = _scene(_square(0, 1, (1, 0, 0)), _square(-1, 9, (1, 0, 0)))
    view = at.Camera((0.01, 0.02, 5), (0.01, 0.02, 0), width=40, height=40)
    frame = at.render(scene, view, SUN)
    front = frame.gbuffer.face < 2
    found = edges(_seen(frame, view), scene.colours)
    beside = np.zeros_like(front)
    for a, b in ((np.s_[1:], np.s_[:-1]), (np.s_[:, 1:], np.s_[:, :-1])):
        beside[a] |= front[a] != front[b]
        beside[b] |= front[a] != front[b]
    assert front.any() and not front.all()
    np.testing.assert_array_equal(found, beside)  # no edges along the diagonals between a square's triangles


def test_a_light_without_extent_is_asked_once_a_subpixel():
    scene = _scene(_square(0, 9, (1, 0, 0)), _square(1, 1, (0, 1, 0)))
    view = at.Camera((0, 0, 5), (0, 0, 0), width=32, height=32)
    once, many = (at.render(scene, view, SUN, spp=1, adaptive=n) for n in (16, 64))
    assert once.rays == many.rays == 32 * 32 + 16 * np.count_nonzero(once.refined)
    np.testing.assert_array_equal(once.image, many.image)


def test_colours_make_edges_and_the_same_plane_does_not():
    for blue, edge in ((0.0, False), (0.05, False), (0.5, True)):
        corners, faces, colours = _square(0, 9, (1, 0, 0))
        colours[1, 2] = blue
        scene = at.Scene.from_arrays(corners, faces, colours)
        view = at.Camera((0, 0.1, 5), (0, 0.1, 0), width=24, height=24)
        frame = at.render(scene, view, SUN)
        assert len(np.unique(frame.gbuffer.face)) == 2
        assert edges(_seen(frame, view), scene.colours).any() == edge


def test_an_edge_pixel_is_the_share_of_its_area_that_is_covered():
    """A white surface on nothing: a pixel's light is that of a full pixel times its coverage, to a sixteenth."""
    scene = _scene(_square(0, 1, (1, 1, 1)))
    view = at.Camera((0, 0, 4), (0, 0, 0), up=(0.3, 1, 0), vfov=40, width=32, height=32)
    frame = at.render(scene, view, SUN, adaptive=16)
    full = frame.image[16, 16]
    many = at.render(scene, view.resized(32 * 16, 32 * 16), SUN, spp=1).gbuffer.face >= 0
    coverage = many.reshape(32, 16, 32, 16).mean((1, 3))
    partly = frame.refined & (coverage > 0) & (coverage < 1)
    assert partly.sum() > 50
    share = frame.image[..., 0] / full[0]
    assert np.abs(share - coverage)[frame.refined].max() < 2 / 16
    assert np.abs(share - coverage)[partly].mean() < 0.6 / 16
    np.testing.assert_array_equal(share[~frame.refined], frame.gbuffer.face[~frame.refined] >= 0)


def test_subpixels_see_what_a_finer_camera_sees(atrium, camera):
    """The sub-pixel (a, b) of a pixel is the centre of a pixel of a camera with a shifted window."""
    triangles, rays = atrium.triangles(), camera.rays(atrium.origin)
    wanted = np.random.default_rng(4).random((H, W)) < 0.1
    g = subpixel_gbuffer(triangles, rays, wanted, 2)
    n, columns = wanted.sum(), g.face.shape[1] // 4
    assert abs(g.face.shape[0] - g.face.shape[1]) <= 8
    renderer = Renderer(atrium, threads=2, gbuffer="rays")
    for row, column in ((0, 0), (1, 3), (3, 2)):
        x, y = OFFSETS[row, column]
        assert column / 4 < x < (column + 1) / 4 and row / 4 < y < (row + 1) / 4
        shifted = rays._replace(corner=rays.corner + (x - 0.5) * rays.dx + (y - 0.5) * rays.dy)
        whole = renderer.see(triangles, _Rays(shifted), renderer.accelerate())
        for name in ("face", "position", "normal", "depth", "side"):
            part = getattr(g, name)[row::4, column::4].reshape(-1, *getattr(g, name).shape[2:])
            np.testing.assert_array_equal(part[:n], getattr(whole, name)[wanted], err_msg=name)
            assert name != "face" or (part[n:] == -1).all()
    assert len(g.face) // 4 * columns >= n and (g.face >= 0).any()


class _Rays:
    """A camera that is given by its rays."""

    listed = False

    def __init__(self, rays):
        self._rays = rays

    def rays(self, origin):
        return self._rays


def test_offsets_are_spread():
    points = OFFSETS.reshape(-1, 2)
    assert sorted((points[:, 0] * 16).astype(int)) == sorted((points[:, 1] * 16).astype(int)) == list(range(16))
    np.testing.assert_allclose(points.mean(0), 0.5, atol=1e-6)


def test_block_means():
    picture = np.arange(8 * 12 * 3, dtype=np.float32).reshape(8, 12, 3)
    means = block_means(picture, 5)
    assert means.shape == (5, 3) and means.dtype == np.float32
    np.testing.assert_array_equal(means[4], picture[4:8, 4:8].mean((0, 1)))


def test_block_copies_are_the_inverse():
    values = np.random.default_rng(0).random((5, 3), np.float32)
    picture = block_copies(values, (8, 12))
    assert picture.shape == (8, 12, 3) and picture.dtype == np.float32
    np.testing.assert_array_equal(block_means(picture, 5), values)
    assert not picture[4:, 8:].any()


def test_finer_samples():
    lights = [
        at.SphereLight((0, 0, 0), 1),
        at.AmbientOcclusion(spp=5),
        at.PointLights(np.zeros((40, 3)), interleave=True),
    ]
    samples = finer_samples(lights, 100, "hammersley")
    np.testing.assert_array_equal(samples.penumbra[0], light_samples(lights[0], 100, "hammersley"))
    assert [s.shape[1] for s in samples.penumbra] == [100, 5, 3]
    assert [s.shape for s in samples.edges] == [(16, 7, 3), (16, 5, 3), (16, 3, 3)]


def test_lights_with_numbers_of_their_own_are_not_asked_again(atrium, camera):
    lights = [at.AmbientOcclusion(2, spp=16), at.PointLights([(0, 5, 0), (2, 5, 1)])]
    coarse, refined = (at.render(atrium, camera, lights, **k) for k in ({}, {"adaptive": 64}))
    for before, after in zip(coarse.visibility, refined.visibility):
        np.testing.assert_array_equal(before, after)
    np.testing.assert_array_equal(refined.refined, edges(_seen(coarse, camera), atrium.colours))
    edge = np.count_nonzero(refined.refined)
    assert coarse.rays + 8 * edge * 18 < refined.rays <= coarse.rays + 16 * edge * 18


def test_nothing_to_refine():
    scene = at.Scene.from_arrays(np.eye(3)[None])
    frame = at.render(scene, at.Camera((5, 5, 5), (9, 9, 9), width=8, height=8), at.PointLight((0, 9, 0)), adaptive=16)
    assert not frame.refined.any() and frame.rays == 0 and not frame.image.any()


@pytest.mark.parametrize("n", [0, -1, 1025, 2.5, True, "many"])
def test_bad_numbers_are_named(atrium, camera, n):
    with pytest.raises(at.InputError, match="adaptive"):
        at.render(atrium, camera, atrium.lights, adaptive=n)
