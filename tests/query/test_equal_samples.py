"""Equal samples: which lights have them, and what is traced and copied for them."""

import numpy as np
import pytest

import antumbra as at
from antumbra.query.equal_samples import any_bit, copy_bits, have_equal_samples, traced_samples, with_distinct_samples
from antumbra.query.light_samples import SAMPLERS, light_samples
from antumbra.query.shadow_query import segments
from asking import query_of

TINY = 1e-9  # below float32's resolution at the position of the lights
HARD = {
    "point": at.PointLight((1, 7, -2)),
    "sun without a diameter": at.DirectionalLight((0.3, -1, 0.2), 0.0),
    "quad smaller than rounding": at.QuadLight((5, 7, 5), (TINY, 0, 0), (0, 0, TINY)),
    "disk smaller than rounding": at.DiskLight((5, 7, 5), (0, -1, 0), TINY),
    "one position, many times": at.PointLights([(1, 7, -2)] * 5),
    "one direction, many times": at.DirectionalLights([(0.3, -1, 0.2)] * 70),
}
SOFT = {
    "quad": at.QuadLight((-1, 7, -1), (2, 0, 0), (0, 0, 2)),
    "disk": at.DiskLight((0, 7, 0), (0, -1, 0), 1.0),
    "ball": at.SphereLight((0, 7, 0), 0.5),
    "sun": at.DirectionalLight((0.3, -1, 0.2)),
    "ambient": at.AmbientOcclusion(2.0),
    "positions": at.PointLights([(1, 7, -2)] * 4 + [(1, 6, -2)]),
    "directions": at.DirectionalLights([(0.3, -1, 0.2), (0.3, -1, 0.3)]),
}


@pytest.fixture(scope="module")
def scene():
    return at.procedural("atrium", triangles=3000)


def _query(scene, light, spp=16):
    return query_of(scene, scene.cameras[0].resized(24, 20), light, spp)[1]


@pytest.mark.parametrize("name", [*HARD, *SOFT])
def test_samples_are_called_equal_exactly_where_all_segments_of_receivers_are(scene, name):
    query = _query(scene, (HARD | SOFT)[name])
    ends, above = segments(query)
    same = bool((ends == ends[:, :, :1]).all())
    assert have_equal_samples(query.light, query.samples) == same == (name in HARD)
    if same:
        assert (above == above[..., :1]).all() and above.any()


@pytest.mark.parametrize("light", HARD.values(), ids=HARD)
def test_a_query_of_equal_samples_keeps_the_first_of_each_set(scene, light):
    query = _query(scene, light)
    few = with_distinct_samples(query)
    assert few.samples.shape == (16, 1, 3) and query.samples.shape[1] > 1
    np.testing.assert_array_equal(segments(few)[0], segments(query)[0][:, :, :1])
    assert with_distinct_samples(few) is few


@pytest.mark.parametrize("light", SOFT.values(), ids=SOFT)
def test_a_query_of_other_samples_stays_the_same_object(scene, light):
    query = _query(scene, light)
    assert with_distinct_samples(query) is query


@pytest.mark.parametrize("sampler", SAMPLERS)
def test_rays_per_receiver_are_known_before_a_light_is_placed(sampler):
    hard, soft = HARD["sun without a diameter"], SOFT["quad"]
    assert traced_samples(hard, light_samples(hard, 16, sampler)) == 1
    assert traced_samples(soft, light_samples(soft, 16, sampler)) == 16


def test_a_sky_of_one_direction_takes_one_ray_and_others_take_all():
    one, many = at.Sky(count=1, interleave=False), at.Sky(count=64)
    assert [traced_samples(sky, light_samples(sky, 16)) for sky in (one, many)] == [1, 4]


@pytest.mark.parametrize("samples", [1, 5, 63, 64, 65, 128, 130])
def test_bits_are_copied_to_each_sample_and_to_none_beyond(samples):
    one = np.random.default_rng(0).integers(0, 2, (3, 4, 1)).astype(np.uint64)
    bits = copy_bits(one, samples)
    assert bits.shape == (3, 4, -(-samples // 64)) and bits.dtype == np.uint64
    np.testing.assert_array_equal(np.bitwise_count(bits).sum(-1), samples * one[..., 0])
    np.testing.assert_array_equal(any_bit(bits), one)
    assert one.any() and not one.all()
