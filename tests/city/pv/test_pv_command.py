"""`antumbra pv`: hundreds of sites from one table, trackers, strings, shards, and errors without a partial file."""

from pathlib import Path

import numpy as np
import pandas
import pytest

import antumbra as at

pytest.importorskip("pvlib")

PLACE = "--latitude", "40", "--longitude", "-3.7", "--timezone", "Europe/Madrid"
HERE = at.Place(40.0, -3.7, timezone="Europe/Madrid")
DAY = "--days", "2026-12-21"


@pytest.fixture
def hall(tmp_path, monkeypatch):
    """A hall of 20 x 20 m, 6 m high, on open ground."""
    monkeypatch.chdir(tmp_path)
    corners = [(x, y, z) for z in (0, 6) for x, y in ((-10, -10), (10, -10), (10, 10), (-10, 10))]
    sides = [(1, 2, 6, 5), (2, 3, 7, 6), (3, 4, 8, 7), (4, 1, 5, 8), (5, 6, 7, 8)]
    ground = [(-90, -90, 0), (90, -90, 0), (90, 90, 0), (-90, 90, 0)]
    text = "".join(f"v {x} {y} {z}\n" for x, y, z in [*corners, *ground])
    Path("hall.obj").write_text(text + "".join(f"f {' '.join(map(str, f))}\n" for f in [*sides, (9, 10, 11, 12)]))
    return at.load("hall.obj", up="z")


def sites(n=300):
    places = np.random.default_rng(4).uniform([-40, 12, 0.5], [40, 40, 3], (n, 3))
    rows = [f"S{k:03d},{x:.3f},{y:.3f},{z:.3f},{10 + k % 40},{90 + k % 180}" for k, (x, y, z) in enumerate(places)]
    Path("sites.csv").write_text("id,x,y,z,tilt,azimuth\n" + "\n".join(rows) + "\n")


def test_300_sites_from_one_table(cli, hall):
    sites()
    told = cli("pv", "hall.obj", "--up", "z", "--modules", "sites.csv", *PLACE, *DAY, "-o", "a.csv", "--json").json()
    table = pandas.read_csv("a.csv")
    assert told["modules"] == 300 and len(table) == 300 * 24 and table["module"].nunique() == 300
    times = pandas.DatetimeIndex(pandas.to_datetime(table["time"][:24])).tz_convert("Europe/Madrid")
    assert str(times[0]) == "2026-12-21 00:30:00+01:00"
    rows = pandas.read_csv("sites.csv").set_index("id")
    for name in ("S000", "S123", "S299"):
        row = rows.loc[name]
        module = at.PvModule(row[["x", "y", "z"]].to_numpy(float), tilt=row["tilt"], azimuth=row["azimuth"])
        alone = at.pvlib_shading(hall, module, times, place=HERE)
        found = table[table["module"] == name]
        for column in alone.columns:
            assert np.allclose(found[column], alone[column], rtol=1e-5, atol=1e-5)
    day = table[table["solar_elevation"] > 5.0]
    assert 0.05 < day["shaded_fraction"].mean() < 0.9 and 0.05 < told["mean_shaded"] < 0.9


def test_shards_give_the_same_bytes(cli, hall):
    sites(70)
    words = "pv", "hall.obj", "--up", "z", "--modules", "sites.csv", *PLACE, *DAY, "--step", "120"
    assert cli(*words, "-o", "whole.csv").code == 0
    for k in range(2):
        assert cli(*words, "-o", "b.csv", "--shard", f"{k}/2").code == 0
    assert not Path("b.csv").exists() and cli("merge", "b.shards").code == 0
    assert Path("b.csv").read_bytes() == Path("whole.csv").read_bytes()


def test_trackers_and_strings_from_a_table(cli, hall):
    rows = [f"R{k},{30 + 5 * k},0,2,180,40,2,0.4,{'east' if k else 'west'}" for k in range(3)]
    Path("rows.csv").write_text("id,x,y,z,axis_azimuth,width,height,gcr,string\n" + "\n".join(rows) + "\n")
    words = "pv", "hall.obj", "--up", "z", "--modules", "rows.csv", *PLACE, *DAY
    assert cli(*words, "--per", "string", "-o", "s.parquet").code == 0
    table = pandas.read_parquet("s.parquet")
    assert table["string"].unique().tolist() == ["west", "east"] and "most_shaded" in table
    assert (table["most_shaded"] >= table["shaded_fraction"] - 1e-12).all()
    up = table["solar_elevation"] > 10.0
    assert table["sky_view_factor"][up].nunique() > 5  # the planes turn


@pytest.mark.parametrize(
    "text, words, told",
    [
        ("id,x,y,z,tilt\na,0,0,8,95\n", (), "a.csv: the row a: the tilt of a module (degrees) is 95"),
        ("id,x,y,z\na,0,0,8\na,1,0,8\n", (), "the id 'a' is that of several rows"),
        ("id,x,y,z,width\na,0,0,8,2\n", (), "the row a: a module has a width and a height, or neither"),
        ("id,x,y,z,tilt,axis_azimuth\na,0,0,8,20,180\n", (), "the row a has an axis_azimuth and a plane"),
        ("id,x,y,z\na,0,0,8\n", ("--per", "string"), "no module has a string"),
        ("id,x,y,z,tilt\na,0,0,8,steep\n", (), "column 'tilt' must hold numbers"),
        ("id,x,y\na,0,0\n", (), "column 'z' is missing"),
        ("id,x,y\na,900,0\n", ("--on-surface",), "where no surface is to place points on"),
    ],
)
def test_errors_leave_no_file(cli, hall, text, words, told):
    Path("a.csv").write_text(text)
    done = cli("pv", "hall.obj", "--up", "z", "--modules", "a.csv", *PLACE, *DAY, *words, "-o", "out.csv")
    assert done.code == 2 and told in done.err and not Path("out.csv").exists(), done


def test_heights_above_the_surface(cli, hall):
    Path("a.csv").write_text("id,x,y,z,tilt\nroof,0,0,1,10\n")
    assert (
        cli("pv", "hall.obj", "--up", "z", "--modules", "a.csv", "--on-surface", *PLACE, *DAY, "-o", "a.parquet").code
        == 0
    )
    factor = pandas.read_parquet("a.parquet")["sky_view_factor"].iloc[0]
    assert factor == pytest.approx((1.0 + np.cos(np.radians(10.0))) / 2.0, abs=1e-3)  # above all there is
