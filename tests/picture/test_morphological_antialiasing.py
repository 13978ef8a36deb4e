"""Anti-aliasing of edges by the shape of boundaries between surfaces."""

import numpy as np
import pytest

import antumbra as at
from antumbra.picture.morphological_antialiasing import mixture
from antumbra.query.surface_links import PictureSurfaces

SIZE = 48
LIGHT = at.DirectionalLight((0.3, -1.0, -0.4))


def board(turn: float = 0.2) -> at.Scene:
    """A white square, turned in the picture's plane, before nothing."""
    c, s = np.cos(turn), np.sin(turn)
    corners = np.array([[c, s, 0], [-s, c, 0], [-c, -s, 0], [s, -c, 0]])
    return at.Scene.from_arrays(corners, [[0, 1, 2], [0, 2, 3]])


def rendered(scene, k: int = 1, **asked) -> at.Frame:
    camera = at.Camera((0, 0, 4), (0, 0, 0), width=SIZE * k, height=SIZE * k)
    return at.render(scene, camera, [at.DirectionalLight((0, 0, -1))], spp=4, **asked)


@pytest.mark.parametrize("turn", [0.2, 0.5, 0.7])
def test_coverage_is_near_the_true_share_of_each_pixel(turn):
    truth = rendered(board(turn), 8).mask.reshape(SIZE, 8, SIZE, 8).mean((1, 3))
    plain, smooth = (rendered(board(turn), antialias=a) for a in (False, True))
    error = [np.sqrt(((frame.coverage - truth) ** 2).mean()) for frame in (plain, smooth)]
    assert error[1] < 0.65 * error[0]
    assert set(np.unique(plain.coverage)) == {0.0, 1.0}


def test_shares_of_a_staircase():
    """A line that falls one pixel in four leaves each pixel the share that it leaves in truth."""
    ids = (np.add.outer(4 * np.arange(8), -np.arange(16)) >= 0).astype(np.int32) - 1  # face 0 below the line
    side, zeros = (ids >= 0).astype(np.int8), np.zeros((*ids.shape, 3), np.float32)
    seen = PictureSurfaces(zeros, zeros, ids, np.ones(ids.shape, np.float32), side, np.float32(1.0))
    shares = side.astype(np.float64)
    mixed = mixture(seen, np.ones((1, 3), np.float32), 1)
    shares.flat[mixed.pixels] = mixed.of(shares)
    falls = np.array([7, 5, 3, 1]) / 8  # the share below a line of slope 1/4 in each pixel that it crosses
    np.testing.assert_array_equal(shares[1, 3:7], falls)
    np.testing.assert_array_equal(shares[2, 7:11], falls)
    assert (shares[4:] == 1.0).all()


def test_bumps_and_high_steps_are_left_alone():
    """Neither a small square nor the end of a wall is worn down."""
    ids = np.full((16, 16), -1, np.int32)
    ids[3:5, 3:5] = ids[10:, 2:14] = 0
    seen = PictureSurfaces(
        np.zeros((16, 16, 3), np.float32), np.zeros((16, 16, 3), np.float32), ids, np.ones(ids.shape, np.float32),
        (ids >= 0).astype(np.int8), np.float32(1.0),
    )  # fmt: skip
    assert len(mixture(seen, np.ones((1, 3), np.float32), 1).pixels) == 0


def test_the_image_is_the_surfaces_light_times_its_share():
    plain, smooth = rendered(board(), antialias=False), rendered(board())
    white = plain.image[SIZE // 2, SIZE // 2]
    np.testing.assert_allclose(smooth.image, smooth.coverage[..., None] * white, rtol=1e-3, atol=1e-6)


def test_bits_visibility_and_surfaces_stay():
    scene, how = at.procedural("city", triangles=3_000), dict(spp=4, filter=True)
    camera = scene.default_camera(64, 64)
    plain, smooth = (at.render(scene, camera, LIGHT, **how, antialias=a) for a in (False, True))
    assert (plain.image != smooth.image).any()
    assert plain.rays == smooth.rays
    for one, other in zip(
        (*plain.bits, *plain.visibility, *plain.gbuffer), (*smooth.bits, *smooth.visibility, *smooth.gbuffer)
    ):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("how", [dict(gbuffer="rays"), dict(plan="grid32+bsah+single"), dict(threads=1)], ids=str)
def test_no_method_changes_the_picture(how):
    scene = at.procedural("city", triangles=3_000)
    camera = scene.default_camera(64, 64)
    one, other = (at.render(scene, camera, LIGHT, spp=4, **more) for more in ({}, how))
    np.testing.assert_array_equal(one.image, other.image)
    np.testing.assert_array_equal(one.coverage, other.coverage)


def test_a_store_gives_the_same_picture(tmp_path):
    scene = at.procedural("city", triangles=3_000)
    at.build_store(scene, tmp_path / "city.antumbra")
    camera = scene.default_camera(64, 64)
    one, other = (at.render(s, camera, LIGHT, spp=4) for s in (scene, at.load(tmp_path / "city.antumbra")))
    np.testing.assert_array_equal(one.image, other.image)


@pytest.mark.parametrize("kind", ["orthographic", "panoramic"])
def test_cameras_that_are_not_perspective(kind):
    more = dict(extent=3.0) if kind == "orthographic" else {}
    camera = at.Camera((0, 0, 4), (0, 0, 0), width=64, height=32, projection=kind, **more)
    frame = at.render(board(), camera, [at.DirectionalLight((0, 0, -1))], spp=4)
    assert ((frame.coverage > 0.0) & (frame.coverage < 1.0)).any()


def test_a_sky_is_mixed_with_the_surfaces():
    frame = rendered(board())
    camera = at.Camera((0, 0, 4), (0, 0, 0), width=SIZE, height=SIZE)
    lights = [at.DirectionalLight((0, 0, -1)), at.Sky((0.0, 0.0, 1.0))]
    plain, mixed = (at.render(board(), camera, lights, spp=4, antialias=a) for a in (False, True))
    part = (frame.coverage > 0.0) & (frame.coverage < 1.0)
    share, red = frame.coverage[part], plain.image[SIZE // 2, SIZE // 2, 0]
    np.testing.assert_allclose(mixed.image[part][:, 0], share * red, rtol=1e-2)
    assert (mixed.image[part][:, 2] > 0.0).all()


def test_adaptive_wins():
    one, other = (rendered(board(), adaptive=16, antialias=a) for a in (False, True))
    np.testing.assert_array_equal(one.image, other.image)


def test_edges_of_colours_on_one_plane():
    """Coplanar faces of two colours mix in the pixels between them, and nowhere else."""
    corners = [[-4, -4, 0], [0.13, -4, 0], [-0.31, 4, 0], [-4, 4, 0], [4, -4, 0], [4, 4, 0]]
    faces = [[0, 1, 2], [0, 2, 3], [1, 4, 5], [1, 5, 2]]
    scene = at.Scene.from_arrays(corners, faces, colours=np.array([[1.0, 0, 0]] * 2 + [[0, 0, 1.0]] * 2))
    image = rendered(scene).image
    mixed = (image[..., 0] > 0) & (image[..., 2] > 0)
    assert mixed.any(1).mean() > 0.5
    assert mixed.sum(1).max() <= 2


def test_frames_from_rows_are_the_same():
    from antumbra.picture.renderer import Renderer
    from antumbra.picture.row_bands import BAND, bits_of_bands

    scene = at.procedural("city", triangles=3_000)
    renderer, camera = Renderer(scene), scene.default_camera(64, 64)
    request = renderer.request(camera, [LIGHT], at.RenderOptions(spp=4))
    rows = renderer.rows(request)
    bands = [rows.band(y, min(y + BAND, 64)) for y in range(0, 64, BAND)]
    kept = bits_of_bands({name: np.concatenate([band[name] for band in bands]) for name in bands[0]})
    made, whole = Renderer(scene).from_rows(request, kept), renderer.render(camera, [LIGHT], spp=4)
    np.testing.assert_array_equal(made.image, whole.image)
    np.testing.assert_array_equal(made.coverage, whole.coverage)


def test_the_ground_is_mixed_beside_surfaces():
    """A pixel that shows surfaces in part has the shadow of its neighbours on the ground, not a hole in it."""
    scene = at.Scene.from_arrays(board().triangles(0.0).vertices.reshape(-1, 3) + (0, 2, 0), [[0, 1, 2], [3, 4, 5]])
    camera = at.Camera((0.5, 4, 6), (0.2, 1, 0), width=64, height=64)
    plain, smooth = (at.render(scene, camera, LIGHT, spp=4, ground=True, antialias=a) for a in (False, True))
    part = (smooth.coverage > 0.0) & (smooth.coverage < 1.0)
    assert (part & plain.mask & (smooth.ground.share.min(2) < 1.0)).any()
    assert (smooth.ground.share >= plain.ground.share.min() - 1e-6).all() and (smooth.ground.share <= 1.0 + 1e-6).all()
    np.testing.assert_array_equal(smooth.ground.mask, plain.ground.mask)
    untouched = smooth.coverage == plain.coverage
    np.testing.assert_array_equal(smooth.ground.share[untouched], plain.ground.share[untouched])


def test_the_light_of_each_layer_is_mixed_too():
    """With and without smooth edges, the layers and the ambient light add up to the image."""
    scene = at.procedural("city", triangles=3_000)
    camera, lights = scene.default_camera(64, 64), [LIGHT, at.PointLight((0, 50, 0), intensity=1e4)]
    for smooth in (False, True):
        frame = at.render(scene, camera, lights, spp=4, bounce=1, layers=True, antialias=smooth, background=False)
        assert not frame.ambient.any()
        np.testing.assert_allclose(sum(frame.layers.images), frame.image, rtol=1e-4, atol=1e-6)
