"""Suns and hours of sun in the package for JavaScript, in node, beside those of Python."""

import json
import subprocess
from datetime import date

import numpy as np
import pytest

import antumbra as at
from antumbra.sun.location import Place
from antumbra.sun.sun_positions import days_of, solar_angles, suns_of, times_of, zone_of
from antumbra.web.javascript_package import ENTRY
from scene_in_node import MESHES, NODE, Asked, without_node

pytest.importorskip("pvlib")
pytestmark = without_node
ASK = """
const { sunPosition, sunsOf } = await import(process.argv[2]);
const { positions = [], days = [] } = JSON.parse(process.argv[3]);
const names = ["times", "hours", "directions"];
const answer = (suns) => Object.fromEntries(names.map((name) => [name, [...suns[name]]]));
const tried = (options) => { try { return answer(sunsOf(options)); } catch (error) { return error.message; } };
console.log(JSON.stringify([positions.map((each) => sunPosition(...each)), days.map(tried)]));
"""


def ask(package, tmp_path, **questions):
    script = tmp_path / "suns.mjs"
    script.write_text(ASK)
    command = [NODE, script, package / ENTRY, json.dumps(questions)]
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)


PLACES = [(52.0, 4.36), (-33.9, 18.4), (0.0, -78.5), (69.6, 18.9), (-77.8, 166.7), (35.7, 139.7), (-45.0, -180.0)]


def test_positions_are_those_of_nrels_algorithm_within_a_hundredth_of_a_degree(package, tmp_path):
    generator = np.random.default_rng(2)
    first, last = (np.datetime64(day).astype("datetime64[s]").astype(np.int64) for day in ("1950-01-01", "2051-01-01"))
    instants, worst = generator.integers(first, last, 300), 0.0
    for latitude, longitude in PLACES:
        asked = [[int(each) * 1000, latitude, longitude] for each in instants]
        altitude, azimuth = np.radians(ask(package, tmp_path, positions=asked)[0]).T
        true, bearing = np.radians(solar_angles(Place(latitude, longitude), instants.astype("datetime64[s]")))
        worst = max(worst, np.degrees(np.abs(altitude - true).max()))
        apart = (azimuth - bearing + np.pi) % (2 * np.pi) - np.pi
        worst = max(worst, np.degrees(np.abs(apart * np.cos(true)).max()))
    assert worst < 0.01


DAYS = [
    {"dates": "2026-06-21", "timezone": "Europe/Amsterdam", "step": 60},
    {"dates": "2026-03-29,2026-10-25", "timezone": "Europe/Amsterdam", "step": 47},
    {"dates": "2026-01-21:2026-12-21:31", "timezone": "-03:30", "step": 20, "up": "z", "north": 12.5},
    {"dates": "2018-11-04:2018-11-05", "timezone": "America/Sao_Paulo", "step": 30},
    {"dates": "year:2024", "timezone": "UTC", "step": 240},
    {"dates": "1962-05-01", "step": 7.5},
]


def test_suns_stand_for_the_intervals_of_python(package, tmp_path):
    places = [{**day, "latitude": 52.0, "longitude": 4.36} for day in DAYS]
    for found, day in zip(ask(package, tmp_path, days=places)[1], DAYS, strict=True):
        place = Place(52.0, 4.36, north=day.get("north", 0.0), timezone=day.get("timezone"))
        times = times_of(days_of(day["dates"]), zone_of(place), day["step"])
        suns = suns_of(place, times, day.get("up", "y"))
        assert np.array_equal(found["times"], suns.times.astype("datetime64[ms]").astype(np.int64))
        assert np.array_equal(found["hours"], suns.hours)
        gap = np.linalg.norm(np.reshape(found["directions"], (-1, 3)) - suns.directions, axis=1)
        assert np.degrees(gap.max()) < 0.01


@pytest.mark.filterwarnings("ignore:.* sensors lie")
@pytest.mark.parametrize("mesh", ["grid", "soup", "no area"])
def test_hours_are_those_of_python(package, tmp_path, mesh):
    vertices, faces = MESHES[mesh]
    scene = at.Scene.from_arrays(vertices if faces is not None else vertices.reshape(-1, 3, 3), faces)
    generator = np.random.default_rng(9)
    lower, upper = vertices.min(0).astype(float), vertices.max(0).astype(float)
    points, normals = generator.uniform(lower, upper, (150, 3)), generator.normal(size=(150, 3))
    place = Place(52.0, 4.36, timezone="+01:00")
    suns = suns_of(place, times_of([date(2026, 1, 21), date(2026, 6, 21)], zone_of(place), 1.0), "y")
    assert len(suns.hours) > 1024
    asked = Asked(package, tmp_path, vertices, faces)
    asked.ask(
        "sunHours", points, normals, {"directions": suns.directions.ravel().tolist(), "hours": suns.hours.tolist()}
    )
    (found,) = asked.answers()
    sensors = at.point_sensors(points, normals)
    keywords = {"place": place, "step": 1.0, "days": [date(2026, 1, 21), date(2026, 6, 21)], "progress": False}
    wanted = at.sun_hours(scene, sensors, **keywords).columns["sun_hours"].values
    assert wanted.max() > 0
    np.testing.assert_array_equal(found["hours"], wanted)


FAULTS = {
    "latitude is 95; it must be from -90 to 90 degrees": {"latitude": 95},
    'dates are 2026-02-30, and 2026-02-30 is no day; write "2026-06-21"': {"dates": "2026-02-30"},
    'timezone Atlantis is unknown; write a name such as "Europe/Amsterdam", or "+01:00"': {"timezone": "Atlantis"},
    "step is 0; it must be from a second to 1440 minutes": {"step": 0},
    "the sun is never above the horizon on 2026-12-21": {"latitude": 80},
}


def test_places_and_dates_that_do_not_exist_are_errors_with_a_cure(package, tmp_path):
    good = {"latitude": 52, "longitude": 4.36, "dates": "2026-12-21"}
    answers = ask(package, tmp_path, days=[{**good, **fault} for fault in FAULTS.values()])[1]
    for found, message in zip(answers, FAULTS, strict=True):
        assert found.startswith(message)
