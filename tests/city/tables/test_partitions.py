"""Partitions: folders of Parquet with the rows of the single file, whoever writes their parts, and checks of these."""

import json
import shutil
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np
import pytest

import antumbra as at
from antumbra.base.command_registry import COMMANDS
from antumbra.city.sensors.sensors import point_sensors
from antumbra.city.sun.sun_hours import sun_blocks
from antumbra.city.sun.sun_options import SunOptions
from antumbra.city.tables.parquet_files import PARTITIONED
from antumbra.city.tables.partitions import Partitions
from antumbra.city.tables.result_table import WRITERS
from antumbra.work.executors import LocalExecutor, ShardExecutor, ShardIndex
from city.tables.test_table_blocks import OPTIONS, PLACE, town

dataset = pytest.importorskip("pyarrow.dataset")
parquet = pytest.importorskip("pyarrow.parquet")

POINTS = "id,x,y,z,code\n" + "".join(f"p{k},{k % 40 - 20},{k // 40 - 10},9,0{k % 7}\n" for k in range(900))


@pytest.fixture
def study(tmp_path, monkeypatch):
    """Runs a study of sun hours whose finished parts are partitions: study(sensors, options, scene)."""
    monkeypatch.setattr("antumbra.city.sun.sun_visibility.SENSORS_PER_PART", 500)

    def run(sensors="raster:0.5", options=OPTIONS, scene=None, executor=None):
        executor = executor or LocalExecutor(tmp_path / "kept")
        return sun_blocks(scene or town(), options, sensors, None, None, executor, True)

    return run


def rows_of(path):
    return dataset.dataset(path).to_table()


def same(a, b):
    """Whether tables are equal, with NaN equal to NaN."""
    return a.to_pandas().equals(b.to_pandas())


@pytest.fixture
def points(tmp_path, monkeypatch):
    """A file of points that is read by block."""
    monkeypatch.setattr("antumbra.city.sensors.sensor_files._AT_ONCE", 0)
    (tmp_path / "points.csv").write_text(POINTS)
    return str(tmp_path / "points.csv")


FORMS = ["raster:0.5", "raster:0.5@3", "grid:0.7", "face", "points"]
CASES = {
    "energy": OPTIONS,
    "bins and the sky": SunOptions(days="2026-03-21,2026-04-02", place=PLACE, step=120, by=("month",), sky_view=16),
    "rules": SunOptions(rule=["en17037-medium"], place=PLACE, step=60),
    "a choice": SunOptions(days="2026-03-21", place=PLACE, step=120, tilt="80:100"),
}


@pytest.mark.parametrize("form, case", [*((form, "energy") for form in FORMS), *(("grid:0.7", case) for case in CASES)])
def test_partitions_have_the_rows_of_the_single_file(study, tmp_path, points, monkeypatch, form, case):
    monkeypatch.setattr("antumbra.city.sun.sun_visibility.SENSORS_PER_PART", 50 if form == "face" else 500)
    form = points if form == "points" else form
    found = study(form, CASES[case])
    found.save(tmp_path / "a.parquets")
    table = study(form, CASES[case], executor=LocalExecutor(None)).whole()
    table.save(tmp_path / "b.parquet")
    rows, expected = rows_of(tmp_path / "a.parquets"), parquet.read_table(tmp_path / "b.parquet")
    names = sorted(path.name for path in (tmp_path / "a.parquets").iterdir())
    assert names[:3] == ["_manifest.json", "part-00000.parquet", "part-00001.parquet"] and len(expected) > 100
    assert rows.schema.remove_metadata() == expected.schema.remove_metadata() and same(rows, expected)


def test_geopandas_reads_partitions_with_their_crs(study, tmp_path):
    geopandas = pytest.importorskip("geopandas")
    study().save(tmp_path / "a.parquets")
    frame = geopandas.read_parquet(tmp_path / "a.parquets")
    assert frame.crs.to_epsg() == 28992 and len(frame) > 1000 and (frame.geometry.x == frame.x).all()


def test_the_manifest_lists_each_part_with_its_rows_and_digest(study, tmp_path):
    found = study()
    found.save(tmp_path / "a.parquets")
    manifest = json.loads((tmp_path / "a.parquets" / "_manifest.json").read_text())
    assert manifest["rows"] == len(found) == sum(part["rows"] for part in manifest["parts"])
    assert manifest["about"] == found.about and manifest["columns"]["sun_hours"]["unit"] == "h"
    for part in manifest["parts"]:
        data = (tmp_path / "a.parquets" / part["file"]).read_bytes()
        assert (len(data), sha256(data).hexdigest()) == (part["bytes"], part["sha256"])


def test_other_outputs_and_sums_are_those_of_the_table(study, tmp_path):
    found, table = study(), study(executor=LocalExecutor(None))
    for k, each in enumerate((found, table)):
        for suffix in ".csv", ".tif", ".npz":
            pytest.importorskip("rasterio")
            each.save(tmp_path / f"{k}{suffix}")
    for suffix in ".csv", ".tif", ".npz":
        assert (tmp_path / f"0{suffix}").read_bytes() == (tmp_path / f"1{suffix}").read_bytes()
    assert len(found) == len(table) and found.totals == table.totals


def test_tables_in_memory_and_by_block_make_equal_folders(study, tmp_path):
    study(executor=LocalExecutor(None)).save(tmp_path / "a.parquets")
    study(executor=LocalExecutor(None)).whole().save(tmp_path / "b.parquets")
    assert len(list((tmp_path / "a.parquets").iterdir())) > len(list((tmp_path / "b.parquets").iterdir())) == 2
    assert same(rows_of(tmp_path / "a.parquets"), rows_of(tmp_path / "b.parquets"))


# --- Checks of parts --------------------------------------------------------------------------------------------------


@pytest.fixture
def units(study, monkeypatch):
    """The partitions that a study would make: units(sensors, options, scene)."""

    def made(*args, **keywords):
        found = []
        finish = lambda self, work: bool(found.extend(work))
        with monkeypatch.context() as patch:
            patch.setattr(LocalExecutor, "finish", finish)
            assert study(*args, **keywords) is None
        (each,) = found
        assert isinstance(each, Partitions)
        return each

    return made


@pytest.mark.parametrize("place", [0.0, 0.3, 0.6, "end", "empty"])
def test_a_damaged_part_is_not_done_and_is_made_again(units, place):
    work = units("raster:0.5")
    work.do(1)
    file = work.root / work.files(1)[0]
    whole = file.read_bytes()
    assert work.done(1) and not work.done(0)
    if place in ("end", "empty"):
        file.write_bytes(whole[:-9] if place == "end" else b"")
    else:
        at_byte = int(place * len(whole) * 0.5)
        file.write_bytes(whole[:at_byte] + bytes([whole[at_byte] ^ 4]) + whole[at_byte + 1 :])
    assert not work.done(1)
    work.do(1)
    assert work.done(1) and file.read_bytes() == whole


def test_a_part_of_another_number_is_not_done(units):
    work = units("raster:0.5")
    work.do(0)
    shutil.copy(work.root / work.files(0)[0], work.root / work.files(1)[0])
    assert work.done(0) and not work.done(1)


def changed(name):
    return replace(OPTIONS, **{name: {"by": ("month",), "energy": False, "step": 120.0, "sky_view": 8}[name]})


def test_the_digest_covers_all_that_columns_depend_on(units, points, tmp_path):
    base = {"options": OPTIONS}
    digests = [units(**base).name]
    digests += [units(options=changed(name)).name for name in ("by", "energy", "step", "sky_view")]
    other_zone = at.Place(52.0, 4.36, timezone="Europe/London")
    digests.append(units(options=replace(OPTIONS, place=other_zone)).name)
    ruled = SunOptions(rule=["en17037-medium"], days="2026-03-21", place=PLACE, step=60, energy=True)
    digests.append(units(options=ruled).name)
    town_of = town()
    digests.append(units(scene=at.Scene.from_arrays(town_of.triangles().vertices, up="z", crs="EPSG:32631")).name)
    digests.append(units(sensors=points).name)
    Path(points).write_text(POINTS.replace(",01\n", ",11\n"))  # a column that rays do not depend on
    digests.append(units(sensors=points).name)
    assert len(set(digests)) == len(digests)
    assert units(**base).name == digests[0]


def test_an_interrupted_study_goes_on_with_its_partitions(units, study, tmp_path):
    work = units("raster:0.5")
    for k in range(0, len(work), 2):
        work.do(k)
    stamps = {path: path.stat().st_mtime_ns for path in (work.root / work.name).glob("*.parquet")}
    share = ShardExecutor(work.root, ShardIndex(0, 1), ["sun"])
    assert len(stamps) > 1 and study("raster:0.5", executor=share) is None
    assert share.units == len(work) and share.did == len(work) - len(stamps)
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in stamps.items())


# --- Folders ----------------------------------------------------------------------------------------------------------


def small_table():
    return at.Table(point_sensors(np.eye(3)), {"a": at.Column(np.arange(3.0), "h", "")})


def test_a_finished_folder_is_replaced_and_other_folders_are_refused(tmp_path):
    path = tmp_path / "a.parquets"
    small_table().save(path)
    (path / "part-00009.parquet").write_bytes(b"stale")
    small_table().save(path)
    assert sorted(each.name for each in path.iterdir()) == ["_manifest.json", "part-00000.parquet"]
    (tmp_path / "b.parquets").mkdir()
    (tmp_path / "b.parquets" / "mine.parquet").write_bytes(b"")
    with pytest.raises(at.InputError, match=r"b.parquets: is a folder; remove it, since it holds no .parquets output"):
        small_table().save(tmp_path / "b.parquets")
    assert (tmp_path / "b.parquets" / "mine.parquet").exists()


def test_files_are_copied_where_the_disk_has_no_links(study, tmp_path, monkeypatch):
    found = study()
    found.save(tmp_path / "a.parquets")

    def refuse(*names):
        raise OSError("no links")

    monkeypatch.setattr("os.link", refuse)
    found.save(tmp_path / "b.parquets")
    names = sorted(path.name for path in (tmp_path / "a.parquets").iterdir())
    assert all((tmp_path / "a.parquets" / n).read_bytes() == (tmp_path / "b.parquets" / n).read_bytes() for n in names)


def test_every_command_that_writes_tables_as_parquet_writes_partitions():
    """Shadow writes polygons, pv a series of times, and viewshed --polygons also polygons: they have no such rows."""
    from inspect import signature

    assert PARTITIONED in WRITERS
    others, checked = {"shadow", "pv"}, set()
    for name, each in COMMANDS.items():
        for option, parameter in signature(each.function(name)).parameters.items():
            for info in getattr(parameter.annotation, "__metadata__", ()):
                suffixes = getattr(getattr(info, "callback", None), "writes", list)()
                if ".parquet" in suffixes and option != "polygons" and name not in others:
                    assert PARTITIONED in suffixes, (name, option)
                    checked.add(name)
    assert checked == {"sun", "viewshed", "visible", "matrix", "los", "route"}
