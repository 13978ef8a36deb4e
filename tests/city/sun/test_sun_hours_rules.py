"""Rules in studies of sun hours: quantities against closed forms and independent sums; verdicts per dwelling.

Each scene is also turned by a quarter, set up along another axis, and measured in feet.
"""

import csv
import json

import numpy as np
import pandas
import pytest
from pvlib.solarposition import get_solarposition

import antumbra as at
import city_files
from antumbra.city.sun.daylight_rules import RULES
from antumbra.city.sun.overcast_sky import OVERCAST_DIRECTIONS
from weather_files import epw

LONDON = at.Place(51.5, -0.1, 0.0, 0.0, "UTC")
SUNSHINE = [62.0, 78, 115, 169, 199, 204, 212, 205, 149, 117, 73, 52]
FRAMES = {"plain": (0.0, "z", 1.0, None), "turned": (90.0, "z", 1.0, None), "feet": (180.0, "y", 1 / 0.3048, "foot")}
"""Name -> turn of the scene (degrees, counterclockwise), its up axis, world units in a metre, and the unit."""


def opposite(angle, frame="plain", facing_south=True):
    """A long wall opposite a window: it rises by an angle above the window's middle. And the window, facing it.

    The window faces south before the turn, or else north.
    """
    turn, up, scale, unit = FRAMES[frame]
    side = -1.0 if facing_south else 1.0
    distance, far = 10.0, 1e5
    height = distance * np.tan(np.radians(angle))
    corners = np.array([[-far, 0, -5], [far, 0, -5], [far, 0, height], [-far, 0, height]]) + (0, side * distance, 0)
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    matrix = np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])  # of row vectors
    corners, normal = scale * corners @ matrix, np.array([0.0, side, 0.0]) @ matrix
    if up == "y":
        corners, normal = corners[:, [0, 2, 1]] * (1, 1, -1), normal[[0, 2, 1]] * (1, 1, -1)
    scene = at.Scene.from_arrays(corners, [[0, 1, 2], [0, 2, 3]], up=up, unit=unit)
    place = LONDON._replace(north=-turn)
    return scene, at.point_sensors(np.zeros((1, 3)), normal[None]), place


def suns(day_or_days, minutes, lowest=0.0):
    """(altitude, azimuth, times) by pvlib: degrees of the suns in the middle of intervals, above an altitude."""
    times = pandas.concat(
        [pandas.Series(pandas.date_range(day, periods=24 * 60 // minutes, freq=f"{minutes}min")) for day in day_or_days]
    )
    times = pandas.DatetimeIndex(times + pandas.Timedelta(minutes=minutes / 2)).tz_localize("UTC")
    found = get_solarposition(times, 51.5, -0.1, 0.0)
    above = (found["elevation"] > lowest).to_numpy()
    return found["elevation"].to_numpy()[above], found["azimuth"].to_numpy()[above], times[above]


def clear_of(altitude, azimuth, angle):
    """Whether a window that faces south sees each sun over a long wall that rises by an angle."""
    ahead = np.cos(np.radians(azimuth - 180.0))
    profile = np.degrees(np.arctan2(np.tan(np.radians(altitude)), ahead))
    return (ahead > 0.0) & (profile > angle)


# --- Vertical sky component -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("angle", [-0.01, 15.0, 25.0, 45.0, 70.0])
def test_a_vertical_sky_component_is_that_of_the_closed_form(angle, frame):
    """Of the CIE's overcast sky above an infinite wall: integrals of cos and of cos sin over its profile angles."""
    scene, window, place = opposite(angle, frame)
    table = at.sun_hours(scene, window, rule="br209-vsc", place=place)
    a = np.radians(max(angle, 0.0))
    expected = 100.0 * (3.0 / 14.0 * (1.0 - np.sin(a)) + 4.0 / (7.0 * np.pi) * np.cos(a) ** 2)
    assert table["br209_vsc"][0] == pytest.approx(expected, abs=0.06)
    assert table["br209_vsc_passes"].tolist() == [expected >= 27.0]
    assert angle > 0.0 or round(expected, 1) == 39.6


def test_the_light_of_the_sky_needs_neither_place_nor_days():
    scene, window, _ = opposite(20.0)
    table = at.sun_hours(scene, window, rule="br209-vsc")
    assert list(table.columns) == ["br209_vsc_passes", "br209_vsc", "azimuth", "tilt"]
    assert table.columns["br209_vsc"].unit == "%" and "latitude" not in table.about
    assert table.about["directions"] == OVERCAST_DIRECTIONS and table.about["suns"] == 0
    (rule,) = table.about["rules"]
    assert rule["name"] == "br209-vsc" and "section 2.2" in rule["citation"]


def test_only_vertical_planes_have_a_vertical_sky_component():
    scene = at.Scene.from_arrays(city_files.CUBE * 3.0, CUBE_FACES, up="z")
    with pytest.warns(UserWarning, match="rule br209-vsc is about vertical planes: 4 of 12 sensors are left out"):
        table = at.sun_hours(scene, "face", rule="br209-vsc")
    assert len(table) == 8 and (table["tilt"] == 90.0).all() and np.allclose(table["br209_vsc"], 39.617, atol=0.06)
    with pytest.raises(at.InputError, match="no sensor lies on one; give points on walls, with the columns nx"):
        at.sun_hours(scene, "face", rule="br209-vsc", tilt="0:10")
    for sensors in ("raster:1", [[0.0, 0.0, 9.0]]):
        with pytest.raises(at.InputError, match="needs to know where windows face; give points on walls"):
            at.sun_hours(scene, sensors, rule="br209-vsc")


CUBE_FACES = np.array([t for a, b, c, d in city_files.CUBE_FACES for t in ((a, b, c), (a, c, d))])

# --- Probable hours, and hours on a day -------------------------------------------------------------------------------


@pytest.mark.parametrize("frame", FRAMES)
def test_probable_hours_are_those_of_an_independent_sum(frame):
    scene, window, place = opposite(40.0, frame)
    table = at.sun_hours(scene, window, rule="br209-apsh", sunshine=SUNSHINE, place=place)
    altitude, azimuth, times = suns(pandas.date_range("2025-01-01", "2025-12-31"), 60)
    seen, months = clear_of(altitude, azimuth, 40.0), times.month.to_numpy() - 1
    probable = np.array(SUNSHINE)[months] / np.bincount(months)[months]
    day = 100 * times.month.to_numpy() + times.day.to_numpy()
    winter = (day >= 921) | (day <= 321)
    for name, counted in (("br209_apsh", seen), ("br209_apsh_winter", seen & winter)):
        assert table[name][0] == pytest.approx(100.0 * probable[counted].sum() / sum(SUNSHINE), abs=1e-9)
    assert 0.0 < table["br209_apsh_winter"][0] < 5.0 and table["br209_apsh"][0] > 25.0
    assert table["br209_apsh_passes"].tolist() == [False]


def test_probable_hours_of_weather_are_its_bright_hours(tmp_path):
    """The file's direct radiation is above 120 W/m2 from February on, in seven hours a day around noon."""
    scene, window, _ = opposite(40.0)
    table = at.sun_hours(scene, window, rule="br209-apsh", epw=epw(tmp_path), place=at.Place(52.0, 4.4))
    times = pandas.date_range("2023-02-01 09:30", "2023-12-31 15:30", freq="h", tz="Etc/GMT-1")
    times = times[(times.hour >= 9) & (times.hour <= 15)]
    found = get_solarposition(times, 52.0, 4.4, 0.0)
    seen = clear_of(found["elevation"].to_numpy(), found["azimuth"].to_numpy(), 40.0)
    assert (
        table["br209_apsh"][0] == pytest.approx(100.0 * seen.mean(), abs=1e-9) and 30.0 < table["br209_apsh"][0] < 70.0
    )
    hours = at.sun_hours(scene, window, rule="en17037-high", lowest=0.0, epw=epw(tmp_path), place=at.Place(52.0, 4.4))
    assert hours.about["step"] == 5.0 and "direct_kwh_m2" not in hours.columns  # possible sun, not that of the weather


def test_the_help_names_every_rule(cli):
    words = cli("sun", "--help").out.replace("\n", " ").split()
    assert all(name in {word.strip(",;.") for word in words} for name in RULES)


def test_unobstructed_ground_has_all_probable_hours():
    scene, _, place = opposite(30.0)
    table = at.sun_hours(scene, [[0.0, 0.0, 1e6]], rule="br209-apsh", sunshine=SUNSHINE, place=place)
    assert table["br209_apsh"][0] == pytest.approx(100.0, abs=1e-9) and table["br209_apsh_passes"][0]
    assert 20.0 < table["br209_apsh_winter"][0] < 40.0


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize(
    "rules, column, day, lowest",
    [
        (["en17037-minimum", "en17037-high"], "en17037_hours", "2025-03-21", 0.0),
        (["din5034-winter"], "din5034_winter_hours", "2025-01-17", 6.0),
        (["din5034-equinox"], "din5034_equinox_hours", "2025-03-21", 6.0),
    ],
)
@pytest.mark.filterwarnings("ignore:.*give it as the lowest altitude")
def test_hours_on_a_day_are_those_of_an_independent_sum(rules, column, day, lowest, frame):
    angle = 12.0
    scene, window, place = opposite(angle, frame)
    table = at.sun_hours(scene, window, rule=rules, place=place)
    altitude, azimuth, _ = suns([day], 5, lowest)
    expected = clear_of(altitude, azimuth, angle).sum() / 12.0
    assert table[column][0] == pytest.approx(expected) and expected > 0.0
    for name in rules:
        least = {"minimum": 1.5, "high": 4.0, "winter": 1.0, "equinox": 4.0}[name.partition("-")[2]]
        assert table[name.replace("-", "_") + "_passes"].tolist() == [expected >= least]


def test_suns_count_above_the_lowest_altitude():
    scene, _, place = opposite(30.0)
    high = [[0.0, 0.0, 1e6]]
    for lowest in (0.0, 11.0, 35.0):
        table = at.sun_hours(scene, high, "2025-03-21", step=5, lowest=lowest, rule="en17037-minimum", place=place)
        expected = len(suns(["2025-03-21"], 5, lowest)[0]) / 12.0
        assert table["sun_hours"][0] == table["en17037_hours"][0] == pytest.approx(expected)
        assert table.about["lowest"] == lowest and table["en17037_minimum_passes"][0] == (expected >= 1.5)
    with pytest.raises(at.InputError, match="no sun is above 89 degrees on these days"):
        at.sun_hours(scene, high, "2025-03-21", lowest=89.0, place=place)
    with pytest.warns(UserWarning, match="en17037-high: suns at any altitude count, but the standard sets a minimum"):
        at.sun_hours(scene, high, rule="en17037-high", place=place)


# --- Several rules ----------------------------------------------------------------------------------------------------


def test_rules_with_different_days_have_no_hours_in_common():
    scene, window, place = opposite(12.0)
    rules = ["din5034-winter", "br209-vsc", "din5034-equinox"]
    table = at.sun_hours(scene, window, rule=rules, place=place)
    assert list(table.columns) == [
        *("din5034_winter_passes", "br209_vsc_passes", "din5034_equinox_passes"),
        *("din5034_winter_hours", "din5034_equinox_hours", "br209_vsc", "azimuth", "tilt"),
    ]
    for rule in rules:  # each as alone
        alone = at.sun_hours(scene, window, rule=rule, place=place)
        for name in alone.columns.keys() & table.columns.keys():
            np.testing.assert_array_equal(alone[name], table[name])
    for keywords in ({"by": ["hour"]}, {"energy": True}):
        with pytest.raises(at.InputError, match="matrix, by and energy are about the same suns for all rules"):
            at.sun_hours(scene, window, rule=rules, place=place, **keywords)


def test_days_give_hours_beside_the_verdicts():
    scene, window, place = opposite(12.0)
    table = at.sun_hours(scene, window, "2025-06-21", rule="br209-vsc", place=place, by=["hour"])
    assert table["sun_hours"][0] > 0.0 and "hours_12" in table.columns and table.shown(None) == "br209_vsc_passes"


def test_a_rule_about_the_sun_needs_a_place():
    scene, window, _ = opposite(12.0)
    with pytest.raises(at.InputError, match="the place is unknown"):
        at.sun_hours(scene, window, rule=["br209-vsc", "din5034-winter"])


# --- One row per window and dwelling ----------------------------------------------------------------------------------


def put_obj(path, vertices, faces):
    lines = [f"v {x:g} {y:g} {z:g}" for x, y, z in np.asarray(vertices).tolist()]
    path.write_text(
        "\n".join([*lines, *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in np.asarray(faces).tolist())]) + "\n"
    )


@pytest.fixture
def windows(tmp_path):
    """A wall in front of two of four windows, as a model and a table."""
    wall = np.array([[-5, -10, 0], [5, -10, 0], [5, -10, 30], [-5, -10, 30]], float)
    put_obj(tmp_path / "wall.obj", wall, [[0, 1, 2], [0, 2, 3]])
    rows = [
        "id,dwelling,floor,x,y,z,nx,ny,nz",
        *("w1,A,1,0,0,1.5,0,-1,0", "w2,A,1,400,0,1.5,0,-1,0", "w3,B,2,0,0,4.5,0,-1,0", "w4,B,2,2,0,4.5,0,-1,0"),
    ]
    (tmp_path / "windows.csv").write_text("\n".join(rows) + "\n")
    return "sun", "wall.obj", "--up", "z", "--sensors", "windows.csv"


def read(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def test_windows_and_dwellings_have_a_row_each_without_joins(cli, tmp_path, windows):
    rules = "--rule", "br209-vsc", "--rule", "en17037-minimum", "--lowest", 10
    place = "--latitude", 51.5, "--longitude", -0.1, "--timezone", "UTC"
    told = cli(*windows, *rules, *place, "-o", "each.csv", "--json").json()
    assert [rule["name"] for rule in told["rules"]] == ["br209-vsc", "en17037-minimum"]
    each = read(tmp_path / "each.csv")
    assert [row["id"] for row in each] == ["w1", "w2", "w3", "w4"]
    assert [row["br209_vsc_passes"] for row in each] == ["False", "True", "False", "False"]
    assert float(each[1]["br209_vsc"]) > 39.0
    done = cli(*windows, *rules, *place, "--per", "dwelling", "-o", "homes.csv", "-o", "homes.json")
    assert done.code == 0 and "br209-vsc" in done.out and "0 of 2 rows pass (0.0 %)" in done.out
    homes = read(tmp_path / "homes.csv")
    assert [(row["dwelling"], row["floor"], row["sensors"]) for row in homes] == [("A", "1", "2"), ("B", "2", "2")]
    assert "id" not in homes[0]  # it differs within a dwelling
    assert [row["br209_vsc_share"] for row in homes] == ["0.5", "0.0"]
    hours = [float(row["en17037_hours"]) for row in each]
    assert [float(row["en17037_hours"]) for row in homes] == [max(hours[:2]), max(hours[2:])]
    assert [row["en17037_minimum_passes"] for row in homes] == [str(max(hours[k : k + 2]) >= 1.5) for k in (0, 2)]
    assert homes[0]["en17037_minimum_passes"] == "True"
    light = [float(row["br209_vsc"]) for row in each]
    assert [float(row["br209_vsc"]) for row in homes] == [min(light[:2]), min(light[2:])]
    assert json.loads((tmp_path / "homes.json").read_text())["about"]["per"] == "dwelling"


def test_windows_without_a_dwelling_belong_to_no_row(tmp_path, windows):
    text = (tmp_path / "windows.csv").read_text().replace("w1,A", "w1,")
    (tmp_path / "windows.csv").write_text(text)
    with pytest.warns(UserWarning, match="1 of 4 sensors has no dwelling, and thus no row"):
        table = at.sun_hours(
            at.load(tmp_path / "wall.obj", up="z"), str(tmp_path / "windows.csv"), rule="br209-vsc", per="dwelling"
        )
    assert table.sensors.attributes["dwelling"].tolist() == ["A", "B"] and table["br209_vsc_passes"].tolist() == [
        True,
        False,
    ]


def test_windows_are_compared_before_dwellings_are_judged(tmp_path, windows):
    """One window passes by itself, the other by what remains, though the worst values of the dwelling do neither."""
    path = str(tmp_path / "windows.csv")
    scenes = (
        at.Scene.from_arrays(city_files.CUBE + (9e3, 9e3, 0), CUBE_FACES, up="z"),
        at.load(tmp_path / "wall.obj", up="z"),
    )
    before, after = (at.sun_hours(scene, path, rule="br209-vsc", per="dwelling") for scene in scenes)
    former, now = before.made_from.table, after.made_from.table
    assert len(former) == len(now) == 4 and next(iter(now.columns)) == "br209_vsc"
    name, columns = "br209_vsc", dict(now.columns)
    columns[name + "_before"] = former.columns[name]._replace(values=np.array([24.0, 60.0, 39.6, 39.6]))
    columns[name + "_loss"] = former.columns[name]._replace(values=columns[name + "_before"].values - now[name])
    rows = after.made_from.make(at.Table(now.sensors, columns, now.about, now.scene))
    assert list(rows.columns)[:4] == [f"{name}_{end}" for end in ("passes", "ratio", "share", "loss")]
    assert rows[f"{name}_passes"].tolist() == [True, False] and rows[f"{name}_share"].tolist() == [1.0, 0.0]
    np.testing.assert_allclose(rows[f"{name}_loss"], rows[f"{name}_before"] - rows[name])
    np.testing.assert_allclose(rows[f"{name}_ratio"][0], (now[name] / [24.0, 60.0, 39.6, 39.6])[:2].min())


@pytest.mark.parametrize(
    "given, words",
    [
        (("--rule", "br209-vsx"), ["--rule 'br209-vsx' is unknown; did you mean 'br209-vsc'"]),
        (("--rule", "br209-apsh"), ["give --epw", "--sunshine JAN/FEB/.../DEC"]),
        (("--rule", "en17037-high"), ["the place is unknown; give --latitude and --longitude, --crs, or --epw"]),
        (("--rule", "br209-vsc", "--per", "dweling"), ["per is 'dweling'", "did you mean 'dwelling'"]),
        (("--rule", "br209-vsc", "--per", "facade"), ["rows per facade need sensors on faces", "a column facade"]),
        (("--rule", "br209-vsc", "--tilt", "0:45"), ["no sensors with a tilt in 0:45"]),
        (("--rule", "br209-vsc", "--column", "moon", "-o", "a.png"), ["no column 'moon'", "br209_vsc"]),
        (("--rule", "br209-apsh", "--sunshine", "1/2"), ["--sunshine", "write twelve mean hours"]),
        (("--rule", "br209-amenity"), ["judges gardens", "--areas"]),
    ],
)
def test_wrong_commands_say_what_is_missing(cli, windows, given, words):
    cli(*windows, *given).refused(*words)


def test_facades_of_a_block_without_semantics_have_a_row_each(cli, tmp_path):
    put_obj(tmp_path / "block.obj", city_files.CUBE * (9.0, 6.0, 12.0), CUBE_FACES)
    cli("sun", "block.obj", "--up", "z", "--sensors", "grid:1", "--rule", "br209-vsc", "--per", "facade", "-o", "f.csv")
    rows = read(tmp_path / "f.csv")
    assert len(rows) == 4 and {row["type"] for row in rows} == {"WallSurface"}
    assert sorted(float(row["azimuth"]) for row in rows) == [0.0, 90.0, 180.0, 270.0]
    assert [row["br209_vsc_passes"] for row in rows] == ["True"] * 4 and len({row["facade"] for row in rows}) == 4
