import numpy as np
import pytest

from antumbra.picture.heat_maps import ColourBar, Panel, blank_panel, draw_bar, letter_size, panel_sheet

GREY = np.linspace(0, 255, 256).astype(np.uint8)[:, None].repeat(3, 1)
BAR = ColourBar(GREY, [(0.0, "0"), (0.5, "5"), (1.0, "10+")], "numbers")


def _place(picture, part):
    """(y, x) of a part of one colour in a picture."""
    ys, xs = np.nonzero((picture == part[0, 0]).all(axis=-1))
    y, x = ys.min(), xs.min()
    assert (picture[y : y + part.shape[0], x : x + part.shape[1]] == part).all()
    return y, x


@pytest.mark.parametrize("n, rows", [(1, 1), (3, 1), (4, 1), (5, 2), (8, 2), (9, 3)])
def test_panels_are_in_rows_of_at_most_four(n, rows):
    parts = [np.full((40, 300, 3), (200, 10 * k, 77), np.uint8) for k in range(n)]
    picture = panel_sheet([Panel(part, ("a", "b")) for part in parts], BAR)
    places = [_place(picture, part) for part in parts]
    columns = -(-n // rows)
    assert [len(set(axis)) for axis in zip(*places)] == [rows, columns]
    assert places == sorted(places) and all(places[k][1] == places[k % columns][1] for k in range(n))
    assert all(b - a > 40 for a, b in zip(sorted({y for y, _ in places}), sorted({y for y, _ in places})[1:]))


def test_a_bar_has_its_colours_from_left_to_right_below_the_caption():
    bar = draw_bar(BAR, 512, 16)
    row = bar[round(1.4 * 16) + 8]
    assert bar.shape[1] == 512 and (row == GREY[np.linspace(0, 255, 512).round().astype(int)]).all()
    assert (bar[:16] > 200).any() and (bar[-16:] > 140).any()


def test_numbers_that_have_no_room_are_left_out():
    ticks = [(k / 12, f"{k * 1000:,}") for k in range(13)]
    all_of, few = (draw_bar(BAR._replace(ticks=ticks), w, 13)[-15:] for w in (2000, 200))
    ink = [(part > 100).any(axis=(0, 2)) for part in (all_of, few)]
    words = [np.count_nonzero(np.diff(np.flatnonzero(row)) > 6) + 1 for row in ink]
    assert words[0] == 13 and 2 <= words[1] <= 5


def test_a_blank_panel_says_why():
    part = blank_panel((30, 400), "no map")
    assert part.shape == (30, 400, 3) and len(np.unique(part.reshape(-1, 3), axis=0)) > 2
    assert (part[[0, -1]] == part[0, 0]).all()


def test_letters_grow_with_the_panels_within_bounds():
    assert [letter_size(w) for w in (1, 400, 10_000)] == [13, 16, 22]
