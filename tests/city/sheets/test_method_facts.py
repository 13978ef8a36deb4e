"""What sheets say of method and sources: units, every parameter, licences and digests, no folders of this machine."""

import hashlib

import pytest

import antumbra as at
from antumbra.city.sheets.method_facts import (
    OVERCAST,
    day_of,
    file_text,
    method_facts,
    place_in_about,
    source_facts,
)
from antumbra.city.sheets.units_text import area_text, unit_text
from antumbra.scene.units import UNITS


def test_parameters_have_their_units():
    about = {
        "job": "viewshed", "length_unit": "us-ft", "observers": 1, "eye_height": 5.5, "max_distance": float("inf"),
        "azimuth": [0.0, 360.0], "refraction": 0.13, "curvature": True, "new_parameter": {"a": 1.5},
    }  # fmt: skip
    facts = dict(method_facts(about, [("sensors", "4")]))
    assert facts["eye height"] == "5.5 us-ft" and facts["greatest distance"] == "no limit"
    assert facts["azimuth"] == "0, 360 degrees" and facts["curvature"] == "yes" and facts["refraction"] == "0.13"
    assert facts["new parameter"] == "a: 1.5" and facts["sensors"] == "4" and facts["software"].startswith("Antumbra ")
    assert dict(method_facts({"job": "skyline", "step": 1.0}))["step"] == "1 degrees"
    assert dict(method_facts({"job": "sun", "step": 15.0}))["step"] == "15 minutes"


def test_no_parameter_of_a_study_is_left_out():
    about = {"job": "sun", "latitude": 52.0, "longitude": 4.0, "elevation": 3.0, "first": "2026-03-21T07",
             "last": "2026-03-22T07", "suns": 4, "hours": 4.0, "surfaces": ["RoofSurface"], "facing": [90.0, 270.0],
             "trees": "trees.gpkg", "x": None}  # fmt: skip
    facts = dict(method_facts(about))
    assert (
        facts["surfaces"] == "RoofSurface" and facts["facing"] == "90, 270 degrees" and facts["trees"] == "trees.gpkg"
    )
    assert "elevation" not in facts and "x" not in facts
    assert place_in_about(about) == at.Place(52.0, 4.0, 3.0) and day_of(about) is None
    assert place_in_about({"job": "viewshed"}) is None
    assert day_of({**about, "last": "2026-03-21T18"}).isoformat() == "2026-03-21"
    assert day_of({"time": "2026-06-21T15:00+02:00"}).isoformat() == "2026-06-21"


def test_every_rule_has_its_text_its_clause_and_its_approximations():
    rules = [{"name": name, "citation": f"clause of {name}", "text": f"{name} demands", "notes": f"{name} assumes"}
             for name in ("br209-vsc", "din5034-winter")]  # fmt: skip
    facts = list(
        method_facts({"job": "sun", "suns": 9, "lowest": 6.0, "directions": 8192, "rules": rules, "per": "flat"})
    )
    for rule in rules:
        at = facts.index((f"rule {rule['name']}", rule["text"]))
        assert facts[at + 1 : at + 3] == [("clause", rule["citation"]), ("approximations", rule["notes"])]
    assert ("sun positions", "9 above 6 degrees") in facts and ("rows", "one per flat") in facts
    assert ("lowest altitude of the sun", "6 degrees") in facts and ("directions of the sky", "8,192") in facts
    assert [name for name, _ in facts].count("method") == 2


def test_a_study_of_the_sky_alone_speaks_of_no_suns():
    facts = list(method_facts({"job": "sun", "suns": 0, "directions": 8192}))
    assert [text for name, text in facts if name == "method"] == [OVERCAST] and "sun positions" not in dict(facts)


def test_sources_name_files_crs_and_unit_without_folders(tmp_path):
    file = tmp_path / "plan.csv"
    file.write_bytes(b"x,y\n")
    about = {"scene": f"{tmp_path}/city.json?lod=2.2", "crs": "EPSG:2263", "length_unit": "us-ft", "up": "z"}
    facts = dict(source_facts(about, None, [file], None))
    assert facts["scene"] == "city.json?lod=2.2" and "New York Long Island" in facts["reference system"]
    assert facts["unit of coordinates"] == "us-ft (0.30480061 m)"
    assert facts["file"] == f"plan.csv: 4 bytes, SHA-256 {hashlib.sha256(b'x,y' + bytes([10])).hexdigest()}"
    assert facts["licence of the data"] == "not stated in the files"
    assert dict(source_facts(about, None, [], "CC0"))["licence of the data"] == "CC0"
    assert file_text(tmp_path) == "a folder of 1 file"
    with pytest.raises(at.InputError, match=r"sources: no\.csv cannot be read"):
        file_text(tmp_path / "no.csv")


def test_areas_and_units_as_sheets_write_them():
    metre, foot = UNITS["m"], UNITS["ft"]
    assert [area_text(x, metre) for x in (0.0, 84.0, 12345.6, 2.5e6)] == ["0 m²", "84 m²", "12,346 m²", "2.5 km²"]
    assert area_text(foot.square_metres * 2500, foot) == "2,500 ft²" and area_text(4.0, UNITS["mm"]) == "4 m²"
    assert [unit_text(x) for x in ("kWh/m2", "m2", "us-ft2", "h", "co2", "")] == [
        "kWh/m²",
        "m²",
        "us-ft²",
        "h",
        "co2",
        "",
    ]
