"""Sample sets: each set is well spread, and so are all sixteen together; the maps onto lights."""

import numpy as np
import pytest

import antumbra as at
from antumbra.base.errors import InputError
from antumbra.query.light_samples import (
    ROTATIONS,
    SAMPLERS,
    domain_sets,
    halton,
    hammersley,
    larcher_pillichshammer,
    light_samples,
    sample_sets,
    to_domain,
)

NETS = [sampler for sampler in SAMPLERS if sampler not in ROTATIONS]


@pytest.mark.parametrize("sampler", SAMPLERS)
@pytest.mark.parametrize("spp", [1, 2, 3, 5, 16, 17, 100, 256, 1000, 1024])
def test_shape_range_and_no_point_twice(sampler, spp):
    sets = sample_sets(spp, sampler)
    assert sets.shape == (16, spp, 2) and sets.dtype == np.float64 and sets.flags.c_contiguous
    assert (sets > 0).all() and (sets < 1).all()
    different = spp if sampler == "halton:0" else 16 * spp  # with halton:0, all sets are the same
    assert len(np.unique(sets.reshape(-1, 2), axis=0)) == different
    np.testing.assert_array_equal(sets, sample_sets(spp, sampler))


@pytest.mark.parametrize("sampler", NETS)
@pytest.mark.parametrize("spp", [4, 16, 64, 256, 1024])
def test_every_set_has_one_point_in_each_cell_and_all_sets_one_in_each_fine_cell(sampler, spp):
    sets = sample_sets(spp, sampler)
    k = int(spp**0.5)

    def occupied(points, k):
        return len(np.unique((points * k).astype(int) @ (1, k)))

    assert all(occupied(s, k) == spp for s in sets)
    if sampler != "sobol":  # each scrambled block is a net; their union is nearly one
        assert occupied(sets.reshape(-1, 2), 4 * k) == 16 * spp


@pytest.mark.parametrize("sampler", NETS)
def test_projections_on_the_axes_are_spread(sampler):
    for s in sample_sets(64, sampler):
        assert len(np.unique((s[:, 0] * 64).astype(int))) == 64
        assert len(np.unique((s[:, 1] * 64).astype(int))) >= 32


def test_the_sets_integrate_better_than_random():
    rng = np.random.default_rng(0)
    f = lambda p: (p[..., 0] ** 2 + p[..., 1] < 0.7).mean(-1)
    truth = f(rng.uniform(size=(2_000_000, 2)))
    random = np.abs(f(rng.uniform(size=(2000, 64, 2))) - truth).mean()
    for sampler in [*NETS, "halton:full"]:
        assert np.abs(f(sample_sets(64, sampler)) - truth).mean() < 0.5 * random


def test_first_points_by_their_definitions():
    np.testing.assert_allclose(hammersley(4), [[0.125, 0], [0.375, 0.5], [0.625, 0.25], [0.875, 0.75]], atol=1e-9)
    y = larcher_pillichshammer(8)[:, 1]
    # bit k of i flips the bits 2**-1 ... 2**-(k+1): 1 -> .1, 2 -> .11, 4 -> .111 (binary)
    np.testing.assert_allclose(y, [0, 0.5, 0.75, 0.25, 0.875, 0.375, 0.125, 0.625], atol=1e-9)


def test_halton_by_its_definition():
    thirds = [1 / 3, 2 / 3, 1 / 9, 4 / 9, 7 / 9, 2 / 9, 5 / 9, 8 / 9]
    halves = [1 / 2, 1 / 4, 3 / 4, 1 / 8, 5 / 8, 3 / 8, 7 / 8, 1 / 16]
    np.testing.assert_allclose(halton(8), np.stack([halves, thirds], 1), atol=1e-9)
    cells = (halton(36 * 2)[35:71] * (4, 9)).astype(int)  # 36 in a row: one in each of 4 x 9 cells
    assert len(np.unique(cells @ (9, 1))) == 36


@pytest.mark.parametrize("n", [1, 20, 100])
@pytest.mark.parametrize("sampler", ROTATIONS)
def test_halton_sets_of_a_hemisphere_are_one_that_is_rotated(sampler, n):
    sets, degrees = domain_sets(n, sampler, "hemisphere"), ROTATIONS[sampler]
    flat = to_domain(halton(n), "hemisphere")
    assert (sets[..., 2] == flat[:, 2]).all() and (sets[..., 2] > 0).all()
    turned = (sets[..., 0] + 1j * sets[..., 1]) / (flat[:, 0] + 1j * flat[:, 1])
    np.testing.assert_allclose(abs(turned), 1, atol=1e-12)
    np.testing.assert_allclose(turned, np.broadcast_to(turned[:, :1], turned.shape), atol=1e-12)
    angles = np.degrees(np.angle(turned[:, 0])) % 360
    if degrees == 0:
        np.testing.assert_allclose(angles, 0, atol=1e-12)
        return
    np.testing.assert_array_equal(np.sort(angles // (degrees / 16)), np.arange(16))  # stratified
    quarters = (angles.reshape(4, 4) / degrees * 4).astype(int)
    for y, x in np.ndindex(4, 4):  # any 2 x 2 pixels of the picture have one from each quarter
        assert set(np.roll(quarters, (y, x), (0, 1))[:2, :2].ravel().tolist()) == {0, 1, 2, 3}


@pytest.mark.parametrize("light", [at.QuadLight((0, 0, 0), (1, 0, 0), (0, 1, 0)), at.SphereLight((0, 0, 0), 1)])
@pytest.mark.parametrize("sampler", ROTATIONS)
def test_halton_sets_of_lights_are_one_that_is_moved(sampler, light):
    square, share = sample_sets(20, sampler), ROTATIONS[sampler] / 360
    np.testing.assert_array_equal(light_samples(light, 20, sampler), to_domain(square, light.domain))
    offsets = (square - halton(20)) % 1
    np.testing.assert_allclose(offsets, np.broadcast_to(offsets[:, :1], offsets.shape), atol=1e-12)
    assert (offsets <= share).all()
    if share:
        assert len(np.unique((offsets[:, 0] / (share / 16)).astype(int)[:, 0])) == 16
        assert offsets[:, 0].mean() == pytest.approx(share / 2, rel=0.05)


def test_rotation_covers_the_hemisphere():
    """The gaps between directions, seen from above, and the shares of directions in quadrants."""
    probes = to_domain(sample_sets(256).reshape(-1, 2), "disk")[:, None, :2]
    gaps, errors = [], []
    for sampler in ("halton:0", "halton:18", "halton:36", "halton:full"):
        points = domain_sets(20, sampler, "hemisphere")[..., :2].reshape(-1, 2)
        gaps.append(np.sqrt(((probes - points) ** 2).sum(-1).min(1)).mean())
        angles = np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) % 1
        starts = np.arange(64)[:, None] / 64
        errors.append(np.abs((((angles - starts) % 1) < 0.25).mean(1) - 0.25).mean())
    assert gaps == sorted(gaps, reverse=True) and gaps[-1] < 0.6 * gaps[0]
    assert errors == sorted(errors, reverse=True) and errors[-1] < 0.1 * errors[0]
    one = domain_sets(20, "halton:0", "hemisphere")[0, :, :2]  # a single set is stratified
    random = to_domain(np.random.default_rng(0).random((100, 20, 2)), "disk")[..., :2]
    nearest = [np.sqrt(((probes - points) ** 2).sum(-1).min(1)).mean() for points in (one, *random)]
    assert nearest[0] < 0.9 * np.mean(nearest[1:])


def test_domains():
    square = sample_sets(256).reshape(-1, 2)
    disk = to_domain(square, "disk")
    radius = np.hypot(*disk[:, :2].T)
    assert radius.max() <= 1
    for r in (0.25, 0.5, 0.75):  # uniform in area
        assert abs((radius < r).mean() - r * r) < 0.01
    np.testing.assert_array_equal(to_domain(np.full((1, 2), 0.5), "disk"), 0)
    np.testing.assert_array_equal(to_domain(square, "square")[:, :2], square)
    for flat in ("square", "disk", "point"):
        assert not to_domain(square, flat)[:, 2].any() and not np.signbit(to_domain(square, flat)[:, 2]).any()
    assert not to_domain(square, "point").any()
    dome = to_domain(square, "hemisphere")
    np.testing.assert_array_equal(dome[:, :2], disk[:, :2])
    np.testing.assert_allclose(np.linalg.norm(dome, axis=1), 1, atol=1e-12)
    for c in (0.3, 0.6, 0.9):  # the density is the cosine: P(height < c) = c^2
        assert abs((dome[:, 2] < c).mean() - c * c) < 0.01


def test_a_light_may_have_its_own_number_of_samples():
    assert light_samples(at.PointLight((0, 0, 0)), 4).shape == (16, 4, 3)
    assert light_samples(at.AmbientOcclusion(), 4).shape == (16, 4, 3)
    assert light_samples(at.AmbientOcclusion(spp=70), 4).shape == (16, 70, 3)


def test_the_samples_of_a_list_are_its_lights():
    positions = np.random.default_rng(1).normal(size=(40, 3)) + 1e6
    every = light_samples(at.PointLights(positions), 4)
    np.testing.assert_array_equal(every, np.broadcast_to(positions, (16, 40, 3)))
    dealt = light_samples(at.PointLights(positions, interleave=True), 4)
    assert dealt.shape == (16, 3, 3)
    assert {tuple(p) for p in dealt.reshape(-1, 3)} == {tuple(p) for p in positions}


@pytest.mark.parametrize("spp", [0, -1, 1025, 2.5, True])
def test_spp_out_of_range(spp):
    with pytest.raises(InputError, match="spp"):
        sample_sets(spp)


def test_unknown_sampler():
    with pytest.raises(InputError, match="larcher-pillichshammer"):
        sample_sets(4, "random")
