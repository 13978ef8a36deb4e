"""Heights as OpenStreetMap writes them: read in the unit of the coordinates, or refused by name and number."""

import numpy as np
import pandas
import pytest

import antumbra as at
from antumbra.city.gis.footprint_table import FootprintOptions, read_footprints
from antumbra.city.gis.length_texts import counts_storeys, lengths_in
from gis_files import buildings, write_buildings

FORMS = {
    "12": 12.0, "12.5": 12.5, " 12 ": 12.0, "12.": 12.0, ".5": 0.5, "1e1": 10.0, "-3": -3.0,
    "12 m": 12.0, "12m": 12.0, "12.5 m": 12.5, "250 cm": 2.5, "0.1 km": 100.0,
    "40 ft": 12.192, "5'": 1.524, "5'3\"": 1.6002, "5' 3\"": 1.6002, "5'3.5''": 1.6129, "10 in": 0.254, "-2 m": -2.0,
}  # fmt: skip
"""Text -> metres."""
OTHERS = "12,5", "3;4", "about 5", "5'3", "12 M", "12-15", "yes", "1_000", "0x10", "12 m 5", "m", "~7"


@pytest.mark.parametrize("text", FORMS)
def test_documented_forms_are_read(text):
    lengths, unread = lengths_in(np.array([text, None, "", float("nan")], object), 1.0)
    assert lengths[0] == pytest.approx(FORMS[text], rel=1e-15) and np.isnan(lengths[1:]).all()
    assert unread.tolist() == [None] * 4


@pytest.mark.parametrize("text", OTHERS)
def test_other_texts_are_named(text):
    lengths, unread = lengths_in(np.array(["3 m", text], object), 1.0)
    assert lengths[0] == 3.0 and np.isnan(lengths[1]) and unread.tolist() == [None, text]


@pytest.mark.parametrize("dtype", ["object", "str", "string", "category"])
def test_columns_of_footprints_may_hold_texts(dtype):
    heights = pandas.Series(["12 m", "40 ft", "5'3\""]).astype(dtype)
    read = read_footprints(buildings(height=heights), FootprintOptions())
    np.testing.assert_allclose(read.heights, [12.0, 12.192, 1.6002], rtol=1e-15)


def test_units_are_those_of_the_coordinates():
    """In feet, 12 m are 39.37; a number without a unit is a number of feet."""
    table = buildings(crs="EPSG:2263", height=["12 m", "40 ft", "7"], low=["1 m", 2, None])
    read = read_footprints(table, FootprintOptions(invalid="skip"))
    survey_foot = 1200.0 / 3937.0
    np.testing.assert_allclose(read.heights, [12.0 / survey_foot, 12.192 / survey_foot, 7.0], rtol=1e-15)
    np.testing.assert_allclose(
        read_footprints(table, FootprintOptions(base="low", invalid="skip")).bases, [1.0 / survey_foot, 2.0]
    )


def test_files_of_footprints_and_trees_hold_texts(tmp_path):
    path = write_buildings(tmp_path / "a.gpkg", buildings(height=["12 m", "6", "40 ft"]))
    assert at.from_footprints(path).bounds[1][2] == pytest.approx(12.192)
    (tmp_path / "t.csv").write_text("x,y,height,radius\n1,2,12 m,3\n9,2,40 ft,3\n")
    assert at.from_trees(tmp_path / "t.csv", base=0.0).bounds[1][2] == pytest.approx(12.192)


def test_texts_that_are_no_lengths_are_counted(tmp_path):
    table = buildings(height=["12,5", "3;4", "8 m"])
    with pytest.raises(
        at.InputError, match=r"footprint 'a' has the height '12,5', which is no length; write 12.5.*and 1 more"
    ):
        at.from_footprints(table)
    with pytest.warns(UserWarning, match="left out 2 footprints; the first, 'a', has the height '12,5'"):
        assert len(at.from_footprints(table, invalid="skip").objects) == 1
    with pytest.raises(at.InputError, match="footprint 'a' has no height"):
        at.from_footprints(buildings(height=[None, "3", "4"]))
    (tmp_path / "t.csv").write_text('x,y,height,radius\n1,2,tall,3\n1,2,"12,5",3\n1,2,3,3\n')
    with pytest.raises(
        at.InputError, match="2 of 3 rows of the column 'height' for height lack a number, such as 'tall'"
    ):
        at.from_trees(tmp_path / "t.csv", base=0.0)


def test_storeys_are_three_metres_high():
    assert counts_storeys("building:levels") and counts_storeys("levels") and not counts_storeys("sea_level")
    table = buildings(**{"building:levels": ["2", "3", "10"]})
    with pytest.warns(UserWarning, match="each storey of the column 'building:levels' is taken to be 3 m high"):
        assert at.from_footprints(table, height="building:levels").bounds[1][2] == 30.0
    with pytest.raises(at.InputError, match="'3;4', which is no length"):
        at.from_footprints(buildings(**{"building:levels": ["3;4", "3", "10"]}), height="building:levels")
