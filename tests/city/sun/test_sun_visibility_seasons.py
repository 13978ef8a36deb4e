"""Leaves of the seasons: each sun has the transmittances of its month; everything without a date has their mean."""

from functools import cache
from math import fsum, prod

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
import oracle
from antumbra.city.sun.sun_visibility import BUNDLE, NO_DATE, bundle_order, sum_suns, sun_query
from antumbra.query.light_samples import light_samples
from antumbra.query.shadow_query import segments
from antumbra.scene.alpha_masks import AlphaMask, cutouts_of, find_cutouts
from antumbra.scene.appearance import Appearance
from antumbra.scene.light_lists import DirectionalLights
from antumbra.scene.materials import BLEND, CLAMP, MONTHS, OPAQUE, Material
from antumbra.sun.sun_positions import Suns
from strength import examples
from surface_crossings import crossings

EQUATOR = at.Place(0.0, 0.0, timezone="UTC")
LEAVES = [0.75, 0.75, 0.625, 0.5, 0.25, 0.25, 0.25, 0.25, 0.5, 0.5, 0.625, 0.75]
SHADE = [0.0, 0.75, 1.0, 0.001, 0.3, 0.2, 0.9, 0.4, 0.4, 0.4, 0.5, 1.0]
"""Shares of each month; 0.001 is below the least one."""


# --- By hand ----------------------------------------------------------------------------------------------------------


def sail(share=None):
    """A horizontal sail above the origin: light from within 45 degrees of the zenith passes through it."""
    scene = at.Scene.from_arrays([[[-2.0, 1, -2], [2, 1, -2], [0, 1, 4]]], name="sail")
    if share is not None:
        scene.set_transmittance({"sail": share})
    return scene


def test_one_sun_in_january_and_one_in_july():
    """At the equator, the sun of noon is within 24 degrees of the zenith. A step of a day makes it the only one."""
    days = "2026-01-15,2026-07-15"
    table = at.sun_hours(sail(LEAVES), [[0.0, 0, 0]], days, place=EQUATOR, step=1440, by=["month"])
    assert table["hours_jan"] == [24 * 0.75] and table["hours_jul"] == [24 * 0.25]
    assert table["sun_hours"] == [24 * 0.75 + 24 * 0.25] and table["longest"] == [24]
    assert str(table["last"][0]).startswith("2026-01-15")  # at least half of the sun of July does not arrive


def test_months_are_those_of_the_wall_clock():
    """In Auckland, it is already April when March ends in Greenwich."""
    place = at.Place(0.0, 174.8, timezone="Pacific/Auckland")
    table = at.sun_hours(sail(LEAVES), [[0.0, 0, 0]], "2026-04-01", place=place, step=60, by=["month"])
    open_hours = at.sun_hours(sail(1.0), [[0.0, 0, 0]], "2026-04-01", place=place, step=60)
    below = at.sun_hours(sail(0.0), [[0.0, 0, 0]], "2026-04-01", place=place, step=60)
    behind = open_hours["sun_hours"] - below["sun_hours"]
    assert behind > 3 and np.allclose(table["sun_hours"], below["sun_hours"] + 0.5 * behind, rtol=1e-7)
    assert "hours_mar" not in table.columns


def test_queries_without_a_date_have_the_mean():
    sun, mean = at.DirectionalLight((0, -1, 0)), fsum(SHADE) / 12
    seen = at.visibility(sail(SHADE), [[0, 0, 0]], [sun])
    assert np.allclose(seen.fraction, mean, rtol=1e-6)
    assert np.array_equal(seen.fraction, at.visibility(sail(mean), [[0, 0, 0]], [sun]).fraction)
    assert sail(SHADE).occluded([0, 0, 0], [0, 1, 0]) == (mean <= 0.5)
    up = at.point_sensors([[0.0, 0, 0]], [[0.0, 1, 0]])
    one, other = (at.sky_view(sail(share), up, directions=256)["sky_view"] for share in (SHADE, mean))
    assert np.array_equal(one, other) and 0 < one < 1


def test_diffuse_light_arrives_as_in_its_month():
    up = at.point_sensors([[0.0, 0, 0]], [[0.0, 1, 0]])
    ask = {"place": EQUATOR, "step": 180, "energy": True, "sky_view": 64}
    both = at.sun_hours(sail(LEAVES), up, "2026-01-15,2026-07-15", **ask)
    parts = [at.sun_hours(sail(LEAVES[m]), up, f"2026-{m + 1:02d}-15", **ask) for m in (0, 6)]
    for name in ("diffuse_kwh_m2", "direct_kwh_m2"):
        np.testing.assert_allclose(both[name], sum(each[name] for each in parts), rtol=1e-9)
    whole = at.sun_hours(sail(fsum(LEAVES) / 12), up, "2026-01-15,2026-07-15", **ask)
    assert np.array_equal(both["sky_view"], whole["sky_view"])
    assert both["diffuse_kwh_m2"] != whole["diffuse_kwh_m2"]


# --- The same as plain transmittances ---------------------------------------------------------------------------------


def hours(scene, days="year:2026", **more):
    points = np.array([[0.0, 0, 0], [0.5, 0, 1], [-1.5, 0.5, 0]])
    return at.sun_hours(scene, points, days, place=EQUATOR, step=480, by=["month"], **more)


share = st.sampled_from([0.0, 0.003, 0.1, 0.5, 2 / 3, 1.0]) | st.floats(0.0, 1.0)
colour = st.tuples(share, share, share)


@examples(25)
@given(share | colour)
def test_twelve_equal_shares_are_one(value):
    one, twelve = sail(value), sail([value] * 12)
    assert (one.cutouts is None) == (twelve.cutouts is None)
    for a, b in zip(one.cutouts or (), twelve.cutouts or ()):
        assert np.array_equal(a, b)
    days = "2026-01-15,2026-07-15"
    for name, column in hours(one, days).columns.items():
        assert np.array_equal(column.values, hours(twelve, days)[name], equal_nan=name in ("first", "last"))


@examples(10)
@given(st.lists(share | colour, min_size=12, max_size=12))
def test_each_month_is_that_of_a_scene_that_never_changes(shares):
    table = hours(sail(shares))
    for month in (0, 5, 11):
        plain, name = hours(sail(shares[month])), f"hours_{MONTHS[month]}"
        assert np.array_equal(table[name], plain[name])


def test_the_order_of_faces_and_the_plan_do_not_matter():
    base, order = forest(), np.random.default_rng(4).permutation(len(forest().triangles().vertices))
    found = [shares_of(base, plan) for plan in ("auto", "bsah+single", "lbvh+packet16", "grid32+bsah+multifrusta")]
    found.append(shares_of(forest(order)))
    for other in found[1:]:
        for a, b in zip(found[0], other):
            assert np.array_equal(a, b)


# --- Against brute force ----------------------------------------------------------------------------------------------


CARDS = 10
RNG = np.random.default_rng(0)
CARD_SHARES = RNG.choice([0.3, 0.5, 0.7, 0.9, 1.0, 0.0], (CARDS, 12, 1), p=[0.2, 0.2, 0.2, 0.2, 0.1, 0.1]) * np.ones(3)
CARD_SHARES[:, 6:] = RNG.uniform(0.2, 1.0, (CARDS, 6, 3))  # coloured from July on
CARD_SHARES[:, 8] = CARD_SHARES[:, 2]  # September is as March


def forest(order=None):
    """Cards of changing transmittance in parallel planes above a floor, with shared diagonals."""
    rng, cards = np.random.default_rng(1), []
    for k in range(CARDS):
        x, z = np.round(rng.uniform(-3, 1, 2))
        a, b, c, d = (
            (x, 0.5 + k / 16, z),
            (x + 2, 0.5 + k / 16, z),
            (x + 2, 0.5 + k / 16, z + 2),
            (x, 0.5 + k / 16, z + 2),
        )
        cards += [(a, b, c), (a, c, d)]
    floor = [[(-6, 0, -6), (-6, 0, 6), (6, 0, 6)], [(-6, 0, -6), (6, 0, 6), (6, 0, -6)]]
    soup, mask = np.array(cards + floor, np.float64), np.array([*np.repeat(np.arange(CARDS), 2), -1, -1], np.int32)
    order = np.arange(len(soup)) if order is None else order
    scene, blank = at.Scene.from_arrays(soup[order], name="forest"), np.zeros((1, 1), np.uint8)
    masks = [AlphaMask(blank, s.mean(0)[None], (CLAMP, CLAMP), s[:, None]) for s in CARD_SHARES]
    scene.data.cutouts = cutouts_of(np.zeros((len(soup), 3, 2), np.float32), mask[order], masks)
    return scene


@cache
def sky_of_suns():
    """High suns, five in each month in a mixed order, as intervals of one hour."""
    rng = np.random.default_rng(2)
    months = rng.permutation(np.repeat(np.arange(12), 5))
    directions = np.column_stack([rng.uniform(-0.5, 0.5, 60), np.ones(60), rng.uniform(-0.5, 0.5, 60)])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    times = np.arange(60).astype("datetime64[h]").astype("datetime64[s]")
    return Suns(times, times, np.ones(60), directions, np.zeros(60), np.zeros(60)), months


def floor_sensors():
    x, z = np.meshgrid(np.linspace(-3, 3, 13), np.linspace(-3, 3, 13))
    points = np.column_stack([x.ravel(), np.zeros(x.size), z.ravel()])
    return at.point_sensors(points, np.broadcast_to([0.0, 1, 0], points.shape))


def shares_of(scene, plan=None):
    """The sums of all sensors, with a column of hours for each sun: the share of its light that arrives."""
    suns, months = sky_of_suns()
    query = sun_query(scene, floor_sensors(), suns, np.arange(60)[:, None], 60, months=months, plan=plan)
    return sum_suns(query)


def true_shares(scene):
    """(sensors, suns): the share of each sun that arrives, a mean over colours, by brute force in float64."""
    suns, months = sky_of_suns()
    sensors, vertices = floor_sensors(), scene.triangles().vertices
    receivers = at.Receivers.on_surface(sensors.points, sensors.normals, scene.origin, scene.middle)
    lights = DirectionalLights(-suns.directions)
    (query,) = scene.engine.queries(receivers, [lights], [light_samples(lights, 1)])
    (ends,), (above,) = segments(query)
    assert above.all()
    shares = np.zeros((len(sensors), 60))
    for s in range(60):
        hits = oracle.all_hits(vertices, query.origins[0], ends[:, s])
        crossed = hits & crossings(vertices, query.origins[0], ends[:, s].astype(np.float64) - query.origins[0])
        for i in range(len(sensors)):
            cards = np.flatnonzero(crossed[i, :-2]) // 2
            touched = np.flatnonzero(hits[i, :-2]) // 2
            passing = [prod(sorted(CARD_SHARES[cards, months[s], c])) for c in range(3)]
            dark = (CARD_SHARES[touched, months[s]] < 1 / 256).all(1).any()  # an opaque card blocks by its edge too
            passing = [0.0 if p < 1 / 256 or dark else p for p in passing]
            shares[i, s] = fsum(passing) / 3
    return shares


def test_shares_of_each_month_equal_brute_force():
    scene = forest()
    found, true = shares_of(scene).binned, true_shares(scene)
    np.testing.assert_allclose(found, true, rtol=4e-6, atol=1e-12)
    assert ((true > 0) & (true < 1)).mean() > 0.2 and (true == 0).mean() > 0.01 and (true == 1).mean() > 0.1


# --- Parts ------------------------------------------------------------------------------------------------------------


def test_months_with_the_same_shares_are_one_season():
    seasons = forest().cutouts.seasons
    assert seasons.tolist() == [0, 1, 2, 3, 4, 5, 6, 7, 2, 9, 10, 11]
    assert sail(LEAVES).cutouts.seasons.tolist() == [0, 0, 2, 3, 4, 4, 4, 4, 3, 3, 2, 0]
    assert not sail(0.5).cutouts.seasons.any()


@pytest.mark.parametrize("sizes", [[], [5], [16, 16], [1, 40, 17], [33, 16, 3]])
def test_bundles_have_one_season(sizes):
    seasons = np.random.default_rng(0).permutation(np.repeat(np.arange(len(sizes)) * 3 - 1, np.array(sizes, int)))
    directions = np.random.default_rng(1).normal(size=(len(seasons), 3))
    order = bundle_order(directions, seasons)
    assert set(order.tolist()) == set(range(len(seasons)))
    assert len(order) == sum(-(-n // BUNDLE) * BUNDLE for n in sizes[:-1]) + sum(sizes[-1:])
    for k in range(0, len(order), BUNDLE):
        assert len(set(seasons[order[k : k + BUNDLE]].tolist())) == 1
    assert NO_DATE in seasons or not sizes


def test_a_face_is_solid_or_clear_only_if_it_is_so_in_every_month():
    def cutouts(*shares, alpha=1.0):
        months = tuple((float(s),) * 3 for s in shares)
        material = Material(factor=(1, 1, 1, alpha), alpha_mode=BLEND if alpha < 1 else OPAQUE, transmittance=months)
        return find_cutouts(Appearance([material], np.zeros(1, np.int32), None, None, None, None, np.zeros(1, bool)))

    assert cutouts(*[0.001] * 11, 0.002) is None  # solid, although the months differ
    clear = cutouts(*[1.0] * 12)
    assert not len(clear.solid) and not len(clear.faces)
    for shares in ([0.0] * 11 + [1.0], [1.0] * 11 + [0.0], [0.0] * 11 + [0.01]):
        found = cutouts(*shares)
        assert found.faces.tolist() == [0] and found.months.shape == (12, 1, 4)
    half = cutouts(*[0.5] * 6, *[1.0] * 6, alpha=0.5)  # half of the light meets the leaf
    assert np.allclose(np.exp2(-half.months[:, 0, 0] / 2.0**24), [0.75] * 6 + [1.0] * 6)
    assert np.allclose(np.exp2(-half.depths[0, 0] / 2.0**24), 0.875)
