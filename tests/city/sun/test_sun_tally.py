"""Sums over suns have the bits of a plain loop, for any number of sensors and samples, with leaves and without."""

import numpy as np
import pytest

from antumbra.city.sun.sun_tally import WHOLE, Calendar, SunLight, tally_of


def _plain(shares, normals, calendar, columns):
    """The sums of one sensor from the shares of the light of each sun, in Python."""
    hours = energy = run = longest = 0.0
    binned, first, last = [0.0] * columns, -1, -1
    for k, share in enumerate(shares.tolist()):
        if calendar.starts[k] or share < 0.5:
            run = 0.0
        hours += share * float(calendar.hours[k])
        for column in calendar.bins[k]:
            binned[column] += share * float(calendar.hours[k])
        (x, y, z), cosine = calendar.directions[k].tolist(), 1.0
        if normals is not None:
            cosine = max(float(normals[0]) * x + float(normals[1]) * y + float(normals[2]) * z, 0.0)
        energy += share * float(calendar.energy[k]) * cosine
        if share >= 0.5:
            run += float(calendar.hours[k])
            longest, first, last = max(longest, run), k if first < 0 else first, k
    return hours, binned, energy, longest, first, last


@pytest.mark.parametrize("sensors", [1, 16, 37])
@pytest.mark.parametrize("samples", [1, 3])
@pytest.mark.parametrize("partial", [False, True])
@pytest.mark.parametrize("sided", [False, True])
def test_sums_are_those_of_a_plain_loop(sensors, samples, partial, sided):
    rng = np.random.default_rng(sensors + samples)
    suns, columns = 150, 4
    words = -(-suns * samples // 64)
    dark = np.repeat(rng.random((sensors, 8 * words)) < 0.6, 8, axis=1)
    dark[0] = True  # a sensor without sun
    passing = np.where(dark, 0.0, rng.choice([0.3, 0.6, 1.0], dark.shape)).astype(np.float32)
    calendar = Calendar(
        rng.permutation(suns * samples).astype(np.int32).reshape(suns, samples),
        rng.choice([0.1, 0.25, 1.0], suns),
        rng.integers(0, columns, (suns, 2)).astype(np.int32),
        rng.random(suns) < 0.1,
        rng.uniform(0.0, 900.0, suns),
        rng.normal(size=(suns, 3)),
    )
    normals = rng.normal(size=(sensors, 3)) if sided else None
    bits = np.packbits(dark, axis=1, bitorder="little").view(np.uint64)
    found = tally_of(SunLight(bits, passing if partial else WHOLE), normals, calendar, columns, 2)
    light = (passing.astype(np.float64) if partial else (~dark).astype(np.float64))[:, calendar.places]
    shares = light[:, :, 0].copy()
    for s in range(1, samples):
        shares += light[:, :, s]
    shares /= samples
    plain = [_plain(shares[i], normals[i] if sided else None, calendar, columns) for i in range(sensors)]
    for name, want in zip(found._fields, zip(*plain)):
        np.testing.assert_array_equal(getattr(found, name), np.array(want))
    assert found.hours[0] == 0.0 and found.first[0] == -1
    assert sensors == 1 or 0.0 < found.longest[1:].min() < found.hours[1:].max()
