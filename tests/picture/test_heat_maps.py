from itertools import pairwise

import numpy as np
import pytest

from antumbra.picture.heat_maps import heat_colours, heat_map, linear_scale, linear_ticks, log_scale


def test_colours_grow_brighter_from_0_to_the_top_and_no_further():
    colours = heat_colours(np.array([-1.0, 0.0, 5.0, 10.0, 1e9]), 10.0)
    assert colours.dtype == np.uint8 and colours.shape == (5, 3)
    assert colours[:2].tolist() == [[13, 8, 135]] * 2 and colours[3:].tolist() == [[240, 249, 33]] * 2
    light = heat_colours(np.linspace(0, 1, 256), 1.0) @ [0.2126, 0.7152, 0.0722]
    assert (np.diff(light) > -1).all() and light[-1] > light[128] + 50 > light[0] + 100


@pytest.mark.parametrize("top", [0.03, 0.9, 1.0, 7.3, 99.0, 100.0, 3457.0, 8.1e6])
def test_scales_have_few_round_numbers(top):
    ticks = linear_ticks(np.linspace(0.0, top, 1000))
    assert ticks[0] == 0.0 and 3 <= len(ticks) <= 9 and 0.99 * top <= ticks[-1] <= 1.5 * top
    assert float(f"{ticks[1]:e}"[0]) in (1, 2, 5) and np.allclose(np.diff(ticks), ticks[1])


@pytest.mark.parametrize(
    "values, last",
    [
        ([3.0, 12.0], "12"),  # the exact maximum
        (np.full(144, 1 / 12).cumsum(), "12"),  # the same with rounding
        ([11.9], "12"),
        ([12.1], "14"),
        ([*[1.0] * 999, 50.0], "1+"),
    ],
)
def test_a_plus_means_that_numbers_lie_beyond_the_scale(values, last):
    ticks = linear_scale(np.array(values)).bar("h").ticks
    assert ticks[-1][1] == last and ticks[-1][0] == 1.0 and ticks[0] == (0.0, "0")
    assert log_scale(np.array([1.0, 100.0])).bar("").ticks[-1][1] == "100"
    assert log_scale(np.r_[np.ones(999), 1e6]).bar("").ticks[-1][1] == "2+"


def test_a_scale_of_nothing():
    assert linear_ticks(np.empty(0)).tolist() == linear_ticks(np.zeros(9)).tolist() == [0.0, 1.0]


def test_a_few_large_numbers_do_not_darken_the_others():
    assert linear_ticks(np.r_[np.ones(999), 1e9])[-1] == 1.0


@pytest.mark.parametrize("low, top", [(0.0031, 7.3), (1.0, 1.0), (1.0, 10.0), (2.0, 5e8), (0.9e-9, 1e-9), (30, 40)])
def test_logarithmic_scales_have_all_round_numbers_between(low, top):
    scale = log_scale(np.r_[np.geomspace(low, top, 99), np.zeros(9)])
    assert scale.logarithmic and {f"{tick:e}"[0] for tick in scale.ticks} <= {"1", "2", "5"}
    ratios = scale.ticks[1:] / scale.ticks[:-1]
    assert len(ratios) >= 1 and ((ratios > 1.99) & (ratios < 2.51)).all()
    assert low / 2.6 < scale.ticks[0] <= 1.1 * low and top / 1.1 <= scale.ticks[-1] < 2.6 * top
    places = scale.places(np.array([0.0, scale.ticks[0], np.sqrt(scale.ticks[0] * scale.ticks[-1]), scale.ticks[-1]]))
    assert places[0] == -np.inf and np.allclose(places[1:], [0.0, 0.5, 1.0])


def test_a_logarithmic_scale_of_nothing():
    assert log_scale(np.zeros(3)).ticks.tolist() == log_scale(np.empty(0)).ticks.tolist() == [1.0, 2.0]


def test_colours_of_a_logarithmic_scale():
    scale = log_scale(np.array([1.0, 100.0]))
    colours = scale.colours(np.array([0.0, 0.5, 10.0, 1e9, 10.0]), np.array([True] * 4 + [False]))
    assert colours[:2].tolist() == [[13, 8, 135]] * 2 and colours[3:].tolist() == [[240, 249, 33], [0, 0, 0]]
    assert colours[2].tolist() == heat_colours(np.array(0.5), 1.0).tolist()
    bar = scale.bar("rays")
    assert [text for _, text in bar.ticks] == ["<1", "2", "5", "10", "20", "50", "100"] and bar.caption == "rays"
    assert (bar.colours[[0, -1]] == colours[[0, 3]]).all() and np.isclose(bar.ticks[3][0], 0.5)


@pytest.mark.parametrize("w, h, n", [(300, 200, 3), (16, 8, 1), (1, 1, 2)])
def test_panels_lie_side_by_side_in_one_scale(w, h, n):
    rng = np.random.default_rng(w)
    panels, known = [rng.random((h, w)) * (k + 1) for k in range(n)], rng.random((h, w)) < 0.7
    picture = heat_map(panels, known, [(f"plan {k}", "of it") for k in range(n)], "numbers")
    assert picture.dtype == np.uint8 and picture.shape[0] > h and picture.shape[1] >= n * max(w, 240)
    top = linear_ticks(np.concatenate([panel[known] for panel in panels]))[-1]
    wanted = [np.where(known[..., None], heat_colours(panel, top), 0) for panel in panels]
    windows = np.lib.stride_tricks.sliding_window_view(picture, (h, w, 3))[:, :, 0]
    found = [np.argwhere((windows[:, :, 0, 0] == part[0, 0]).all(-1)) for part in wanted]
    places = [[p for p in candidates if (windows[tuple(p)] == part).all()] for candidates, part in zip(found, wanted)]
    assert all(places)
    if w > 1:
        assert [len(p) for p in places] == [1] * n and len({p[0][0] for p in places}) == 1
        assert all(a[0][1] + w < b[0][1] for a, b in pairwise(places))


def test_long_labels_stay_within_their_panel():
    known = np.ones((20, 40), bool)
    short, long = (heat_map([known * 1.0], known, [(text,)], "c") for text in ("a", "grid32:paper+" * 5))
    assert short.shape == long.shape and (short != long).any()
    assert (short[:, -10:] == long[:, -10:]).all()
