"""The scale of a map: round, exact on the paper in every format, and refused in one line if it is impossible."""

import re
import xml.etree.ElementTree as Xml

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
from antumbra.city.sheets.map_frame import Extent, fit_map, round_scale
from antumbra.city.sheets.sheet_options import ORIENTATIONS, PAPERS
from antumbra.city.tables.result_table import Column, Table
from antumbra.scene.units import METRE, UNITS
from pdf_pages import pdf_text
from strength import examples

pytest.importorskip("matplotlib")

FOOT = UNITS["ft"]


# --- Round numbers ----------------------------------------------------------------------------------------------------


@examples(80)
@given(least=st.floats(1e-3, 1e8))
def test_round_scales_are_the_next_of_their_rulers(least):
    metric, feet = round_scale(least, METRE), round_scale(least, FOOT)
    assert least * (1 - 1e-8) <= metric <= 1.5001 * least and least * (1 - 1e-8) <= feet <= 2.0001 * least
    assert float(f"{metric:.2e}") == pytest.approx(metric) and float(f"{feet / 12:.0e}") == pytest.approx(feet / 12)


def test_scales_of_rulers():
    assert [round_scale(n, METRE) for n in (99, 100, 101, 400, 510, 751)] == [100, 100, 125, 400, 600, 1000]
    assert [round_scale(n, FOOT) for n in (100, 121, 480, 500, 721, 961)] == [120, 240, 480, 600, 960, 1200]
    fit = fit_map(Extent(0, 0, 300, 200), FOOT, at.Sheet(scale=600))
    assert fit.text(FOOT) == "1:600 (1 in = 50 ft)" and fit.text(METRE) == "1:600"


# --- Fit --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("unit", ["m", "ft", "us-ft", "mm"])
@pytest.mark.parametrize("paper", PAPERS)
@pytest.mark.parametrize("orientation", ORIENTATIONS)
def test_the_frame_is_exactly_the_extent_at_the_scale(paper, orientation, unit):
    unit = UNITS[unit]
    wanted = Extent(85000.0, 446000.0, 85000.0 + 70.0 / unit.metres, 446000.0 + 260.0 / unit.metres)
    fit = fit_map(wanted, unit, at.Sheet(paper=paper, orientation=orientation))
    per_mm = fit.denominator / 1000.0 / unit.metres
    assert fit.extent.width == pytest.approx(fit.layout.map.width * per_mm, rel=1e-9)
    assert fit.extent.height == pytest.approx(fit.layout.map.height * per_mm, rel=1e-9)
    assert fit.extent.west < wanted.west and fit.extent.east > wanted.east
    assert fit.extent.south < wanted.south and fit.extent.north > wanted.north
    assert (fit.layout.width > fit.layout.height) == (orientation == "landscape")  # auto: this one is upright


def test_the_extent_of_a_sheet_is_shown_whole():
    fit = fit_map(Extent(0, 0, 11, 21), METRE, at.Sheet(extent=[10, 20, 60, 50], scale=500))
    assert (
        fit.extent.west < 10 and fit.extent.east > 60 and (fit.extent.west + fit.extent.east) / 2 == pytest.approx(35)
    )


def test_an_impossible_scale_names_those_that_are_possible():
    with pytest.raises(at.InputError) as error:
        fit_map(Extent(0, 0, 600, 400), METRE, at.Sheet(scale="1:500"))
    message = "scale: 1:500 does not fit on A4; the extent of 600 x 400 m needs 1:4,000, or A3, where 1:2,500 fits"
    assert str(error.value) == message
    for paper, scale in (("a4", 4000), ("a3", 2500)):
        assert fit_map(Extent(0, 0, 600, 400), METRE, at.Sheet(paper=paper, scale=scale)).denominator == scale
    with pytest.raises(at.InputError, match=r"needs 1:2,500$"):
        fit_map(Extent(0, 0, 600, 400), METRE, at.Sheet(scale="1:500", paper="a3"))


# --- Positions on the paper -------------------------------------------------------------------------------------------


def made(unit, turned):
    """A table of three points, 60 and 40 m apart, at right angles; turned by a quarter, if so."""
    points = np.array([[0.0, 0.0, 1.0], [60.0, 0.0, 1.0], [0.0, 40.0, 1.0]])
    if turned:
        points = points[:, [1, 0, 2]] * [-1.0, 1.0, 1.0]
    scale = 1.0 / UNITS[unit].metres
    ground = np.array([[[-90.0, -90, 0], [90, -90, 0], [90, 90, 0]], [[-90, -90, 0], [90, 90, 0], [-90, 90, 0]]])
    scene = at.Scene.from_arrays(ground * scale, up="z", unit=unit, name="flat")
    return Table(at.point_sensors(points * scale), {"hours": Column(np.array([1.0, 2, 3]), "h", "hours")}, {}, scene)


def places_in_svg(path):
    """(3, 2) millimetres: the places of the marks, up."""
    root = Xml.parse(path).getroot()
    space = "{http://www.w3.org/2000/svg}"
    height = float(root.get("viewBox").split()[3])
    assert root.get("width").endswith("pt")
    marks = next(each for each in root.iter(f"{space}g") if each.get("id") == "PathCollection_1")
    found = [(float(use.get("x")), height - float(use.get("y"))) for use in marks.iter(f"{space}use")]
    return np.array(found) * 25.4 / 72.0


def places_in_pdf(path):
    found = re.findall(r"1 0 0 1 ([-0-9.]+) ([-0-9.]+) cm\s+/(?:P|M)\S+ Do", pdf_text(path))
    steps = np.array(found, float)  # each relative to the one before
    return np.cumsum(steps, 0)[:3] * 25.4 / 72.0


def places_in_png(path):
    from PIL import Image

    image = Image.open(path)
    assert image.info["dpi"] == pytest.approx((200, 200), abs=0.01)
    pixels = np.asarray(image.convert("RGB")).astype(int)
    scale = [np.array(c) for c in colours()]
    places = []
    for colour in scale:
        rows, columns = np.nonzero((np.abs(pixels - colour) <= 1).all(-1)[:, : int(pixels.shape[1] * 0.65)])
        places.append((columns.mean() + 0.5, pixels.shape[0] - rows.mean() - 0.5))
    return np.array(places) * 25.4 / 200.0


def colours():
    from antumbra.city.tables.map_scale import map_scale

    values = np.array([1.0, 2.0, 3.0])
    return map_scale(values, np.ones(3, bool), "h").colours(values)


@pytest.mark.parametrize("unit, turned", [("m", False), ("m", True), ("us-ft", False)])
@pytest.mark.parametrize("suffix", ["pdf", "svg", "png"])
def test_lengths_on_the_paper_are_those_of_the_scale(tmp_path, suffix, unit, turned):
    path = tmp_path / f"map.{suffix}"
    made(unit, turned).save_map(path, sheet=at.Sheet(scale=750, orientation="landscape", pages=["map"]))
    places = {"pdf": places_in_pdf, "svg": places_in_svg, "png": places_in_png}[suffix](path)
    across, up = places[1] - places[0], places[2] - places[0]
    exact = {"pdf": 1e-4, "svg": 1e-4, "png": 0.1}[suffix]  # millimetres; half a pixel has 0.06
    if turned:
        across, up = np.array([across[1], -across[0]]), np.array([up[1], -up[0]])
    assert across == pytest.approx([60_000 / 750, 0.0], abs=exact) and up == pytest.approx(
        [0.0, 40_000 / 750], abs=exact
    )
