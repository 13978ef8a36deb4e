"""The discontinuity filter: pixels that it mixes, pixels that it must not mix, and its effect."""

import numpy as np
import pytest

import antumbra as at
from antumbra.picture.discontinuity_filter import filter_fractions, filter_shares, smooth_irradiance
from antumbra.query.receivers import NOTHING
from antumbra.query.surface_links import PictureSurfaces

H, W, SPP = 14, 18, 16
PIXEL = 0.01


def _wall(faces=None):
    """A wall at depth 1, seen at a right angle. By default every pixel sees another face, as on a fine mesh."""
    y, x = np.mgrid[:H, :W].astype(np.float32)
    position = np.stack([x * PIXEL, y * PIXEL, np.zeros_like(x)], -1).astype(np.float32)
    normal = np.broadcast_to(np.float32([0, 0, 1]), position.shape).copy()
    face = np.arange(H * W, dtype=np.int32).reshape(H, W) if faces is None else faces
    return PictureSurfaces(
        position, normal, face, np.ones((H, W), np.float32), np.ones((H, W), np.int8), np.float32(PIXEL)
    )


def _noise(mean, seed=0):
    return np.random.default_rng(seed).integers(mean - 1, mean + 2, (H, W))


def _by_hand(counts):
    """The weighted mean of 5 x 5 pixels, for pixels inside the picture."""
    w = np.outer([1, 2, 2, 2, 1], [1, 2, 2, 2, 1])
    windows = np.lib.stride_tricks.sliding_window_view(counts, (5, 5))
    return (1 - (windows * w).sum((2, 3)) / (64 * SPP)).astype(np.float32)


@pytest.mark.parametrize("faces", [None, np.zeros((H, W), np.int32)])
def test_a_flat_surface_is_averaged_whatever_its_faces(faces):
    counts = _noise(8)
    out = filter_fractions(_wall(faces), counts, SPP)
    assert out.dtype == np.float32
    np.testing.assert_array_equal(out[2:-2, 2:-2], _by_hand(counts))
    plain = 1 - counts / SPP
    assert out[0].std() < 0.5 * plain[0].std()  # the picture's border is filtered as well


def test_every_sample_set_counts_once():
    """Only one sample of set k is occluded. So it is 1 of 256 for each pixel inside the picture."""
    y, x = np.mgrid[:H, :W]
    for k in range(16):
        counts = ((x % 4 + 4 * (y % 4)) == k).astype(int)
        out = filter_fractions(_wall(), counts, SPP)
        np.testing.assert_array_equal(out[2:-2, 2:-2], np.float32(255 / 256))


def test_shares_are_averaged_over_the_pixels_whose_counts_are():
    counts = np.where(np.arange(W) < W // 2, _noise(4), _noise(12, 1))
    rng, faces = np.random.default_rng(3), np.broadcast_to(np.arange(W, dtype=np.int32) // 5, (H, W)).copy()
    seen = _wall(faces)
    seen.normal[:, 10:] = (0, 1, 0)
    weights = rng.random((H, W)).astype(np.float32)
    for shares in ((1 - counts / SPP).astype(np.float32), weights):
        fraction, smooth = filter_shares(seen, counts, shares, SPP)
        np.testing.assert_array_equal(fraction, filter_fractions(seen, counts, SPP))
        np.testing.assert_array_equal(smooth, filter_shares(seen, counts, shares, SPP, threads=2)[1])
        if shares is not weights:
            np.testing.assert_allclose(smooth, fraction, atol=1e-6)
        assert 0.0 < smooth.std() < shares.std()
    flat = np.full((H, W), 8)
    assert filter_shares(seen, flat, weights, SPP)[1][:, 2:8].std() < 0.5 * weights.std()


@pytest.mark.parametrize("count", [0, 5, SPP])
def test_what_is_constant_stays_so(count):
    seen = _wall()
    seen.normal[:] = np.random.default_rng(1).normal(size=seen.normal.shape)  # on any surface
    out = filter_fractions(seen, np.full((H, W), count), SPP)
    np.testing.assert_array_equal(out, np.float32(1 - count / SPP))


def test_a_steady_slope_stays_so():
    counts = np.broadcast_to(4 * np.arange(W), (H, W))
    out = filter_fractions(_wall(), counts, 4 * W)
    np.testing.assert_array_equal(out[2:-2, 2:-2], np.float32(1 - counts / (4 * W))[2:-2, 2:-2])


def _tilted(seen, half):
    angle = np.radians(25.0)
    seen.normal[half] = np.sin(angle), 0, np.cos(angle)


def _behind(seen, half):
    seen.position[*half, 2] -= 0.6 * PIXEL


def _elsewhere(seen, half):  # at a grazing angle a parallel plane is as near in depth as the same plane
    seen.position[half] += np.float32([30 * PIXEL, 0, 0.6 * PIXEL])


def _nothing(seen, half):
    seen.side[half], seen.face[half] = NOTHING, -1


@pytest.mark.parametrize("change", [_tilted, _behind, _elsewhere, _nothing])
def test_surfaces_do_not_mix(change):
    """The right half sees another surface, so its counts do not change the left half."""
    seen, half = _wall(), np.s_[:, W // 2 :]
    change(seen, half)
    counts = _noise(8)
    changed = counts.copy()
    changed[half] = 6
    out, other = filter_fractions(seen, counts, SPP), filter_fractions(seen, changed, SPP)
    np.testing.assert_array_equal(out[:, : W // 2], other[:, : W // 2])
    same = _wall()
    assert (filter_fractions(same, counts, SPP) != filter_fractions(same, changed, SPP))[:, : W // 2].any()
    assert (out[:, : W // 2] != np.float32(1 - counts / SPP)[:, : W // 2]).any()  # the left half is filtered by itself
    if change is _nothing:
        np.testing.assert_array_equal(out[half], np.float32(1 - counts / SPP)[half])


def test_one_face_is_one_surface_however_its_positions_were_rounded():
    seen, counts = _wall(np.zeros((H, W), np.int32)), _noise(8)
    seen.position[...] = np.random.default_rng(2).normal(size=seen.position.shape)
    np.testing.assert_array_equal(filter_fractions(seen, counts, SPP)[2:-2, 2:-2], _by_hand(counts))


def test_smooth_curves_are_one_surface():
    """A cylinder of many faces. Its normal turns by two degrees from pixel to pixel."""
    seen, counts = _wall(), _noise(8)
    radius, angle = PIXEL / np.radians(2.0), np.radians(2.0) * (np.arange(W) - W / 2)
    seen.normal[...] = np.stack([np.sin(angle), 0 * angle, np.cos(angle)], -1)
    seen.position[..., 0], seen.position[..., 2] = radius * np.sin(angle), radius * np.cos(angle)
    np.testing.assert_array_equal(filter_fractions(seen, counts, SPP)[2:-2, 2:-2], _by_hand(counts))


def test_sharp_shadows_stay_sharp():
    counts = np.where(np.arange(W) < W // 2, 0, SPP) + np.zeros((H, 1), int)
    out = filter_fractions(_wall(), counts, SPP)
    np.testing.assert_array_equal(out, np.float32(1 - counts / SPP))


def test_threads_do_not_matter():
    counts = np.random.default_rng(3).integers(0, SPP + 1, (H, W))
    one, three = (filter_fractions(_wall(), counts, SPP, threads=t) for t in (1, 3))
    np.testing.assert_array_equal(one, three)


def _shadow(**options):
    """A square's shadow on a floor, with a penumbra of 16 pixels. The camera is below the square."""
    square = np.array([[-1.0, 0, -1], [1, 0, -1], [1, 0, 1], [-1, 0, 1]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    scene = at.Scene.from_arrays(np.concatenate([square * 20, square + (0, 2, 0)]), faces)
    light = at.QuadLight((-0.5, 4, -0.5), (1, 0, 0), (0, 0, 1))
    camera = at.Camera((0, 1.9, 0), (0, 0, 0), (0, 0, 1), 110, 96, 96)
    return at.render(scene, camera, light, **options)


def test_less_error_in_a_penumbra_and_the_bits_as_they_were():
    plain, smooth, truth = _shadow(), _shadow(filter=True), _shadow(spp=1024).visibility[0]
    np.testing.assert_array_equal(plain.bits[0], smooth.bits[0])
    assert plain.rays == smooth.rays and smooth.timings["filter"] > 0
    error = [np.sqrt(np.mean((f.visibility[0] - truth) ** 2)) for f in (plain, smooth)]
    assert error[1] < 0.5 * error[0]
    assert (smooth.image != plain.image).any()


def test_refined_visibility_is_filtered_as_well():
    plain, smooth, truth = _shadow(adaptive=64), _shadow(adaptive=64, filter=True), _shadow(spp=1024).visibility[0]
    np.testing.assert_array_equal(plain.refined, smooth.refined)
    error = [np.sqrt(np.mean((f.visibility[0] - truth) ** 2)) for f in (plain, smooth)]
    assert error[1] < 0.7 * error[0]


@pytest.mark.parametrize("light", [at.PointLight((0, 5, 0)), at.DirectionalLight((0.3, -1, 0.2), 0.0)])
def test_lights_without_extent_are_not_smoothed(light):
    """All samples are one point, so neighbours' samples add nothing."""
    scene = at.procedural("atrium", triangles=5000)
    camera = scene.cameras[0].resized(48, 36)
    plain, smooth = (at.render(scene, camera, light, spp=1, filter=f) for f in (False, True))
    np.testing.assert_array_equal(plain.visibility[0], smooth.visibility[0])
    assert 0 < plain.visibility[0].mean() < 1
    assert (np.bitwise_count(plain.bits[0]) <= 1).all()


def test_irradiance_is_averaged_over_the_same_surface_only():
    """Pixels on both sides of a gap in depth get 16 kinds of light. Pixels inside get the mean of their side."""
    y, x = np.mgrid[:H, :W]
    seen, right = _wall(), x >= W // 2
    seen.position[right, 2] -= 1.0
    kind = (x % 4 + 4 * (y % 4)).astype(np.float32) + 100.0 * right
    arrived = np.stack([kind, 2 * kind, kind * 0], -1).astype(np.float32)
    out = smooth_irradiance(seen, arrived)
    assert out.dtype == np.float32
    inside = np.zeros((H, W), bool)
    inside[2:-2, 2 : W // 2 - 2] = inside[2:-2, W // 2 + 2 : -2] = True
    expected = np.stack([7.5 + 100.0 * right, 15 + 200.0 * right, 0 * x], -1)
    np.testing.assert_array_equal(out[inside], expected[inside])
    assert out[~right, 0].max() < 16 and out[right, 0].min() >= 100


def test_the_pattern_of_an_interleaved_list_is_averaged_away():
    rng = np.random.default_rng(2)
    scene = at.Scene.from_arrays(
        np.float64([[[-50, 0, -50], [-50, 0, 50], [50, 0, 50]], [[-50, 0, -50], [50, 0, 50], [50, 0, -50]]])
    )
    camera = at.Camera((0, 3, 0.01), (0, 0, 0), width=24, height=20)
    positions = rng.uniform((-3, 8, -3), (3, 9, 3), (160, 3))
    every, dealt = (at.PointLights(positions, interleave=i, indirect=True) for i in (False, True))
    truth, plain = (at.render(scene, camera, light).image for light in (every, dealt))
    smooth = at.render(scene, camera, dealt, filter=True).image
    inside = np.s_[2:-2, 2:-2]
    assert np.abs(smooth - truth)[inside].max() < 0.1 * np.abs(plain - truth)[inside].max()
    np.testing.assert_array_equal(at.render(scene, camera, every, filter=True).image, truth)
