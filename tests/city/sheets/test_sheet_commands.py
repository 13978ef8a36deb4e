"""The options --map and --sheet of every command whose results can be drawn; wrong ones leave no file."""

import numpy as np
import pytest

from antumbra.city.sheets.sheet_options import PAPERS
from sheet_cases import site

pytest.importorskip("matplotlib")

HERE = "--latitude", "52", "--longitude", "4.36", "--timezone", "Europe/Amsterdam"
RASTER = "--sensors", "raster:8+1.6"
TURBINE = "--turbine", "0,-45,0", "--hub-height", "30", "--rotor", "20"
COMMANDS = {
    "sun": ("sun", *HERE, "--days", "2026-03-21", "--step", "240", "--sensors", "windows.csv"),
    "sun per building": ("sun", *HERE, "--days", "2026-03-21", "--step", "240", "--per", "building"),
    "viewshed": ("viewshed", *RASTER, "--observer", "0,0,1.6"),
    "visible": ("visible", *RASTER, *TURBINE),
    "matrix": ("matrix", *RASTER, "--targets", "windows.csv"),
    "los": ("los", "--from", "0,-40,1.6", "--targets", "windows.csv"),
    "skyline": ("skyline", "--point", "0,0,1.6"),
    "shadow": ("shadow", *HERE, "--at", "2026-03-21T15:00"),
    "hours of shadow": ("shadow", *HERE, "--days", "2026-03-21", "--cell", "8", "--step", "240"),
}
"""Name -> words without the scene."""


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A folder with a scene and three windows."""
    monkeypatch.chdir(tmp_path)
    corners = np.asarray(site().triangles().vertices + site().triangles().origin).reshape(-1, 3)
    lines = [f"v {x} {y} {z}" for x, y, z in corners.tolist()]
    lines += [f"f {k} {k + 1} {k + 2}" for k in range(1, len(corners), 3)]
    (tmp_path / "site.obj").write_text("\n".join(lines) + "\n")
    (tmp_path / "windows.csv").write_text("x,y,z,id\n-25,9.9,1.5,W1\n-9,9.9,4.5,W2\n20,7.9,4,W3\n")
    return tmp_path


def words(name):
    command, *rest = COMMANDS[name]
    if command == "shadow":
        pytest.importorskip("shapely", reason="shadows need antumbra[gis]: their sheets are NOT checked")
    return command, "site.obj", "--up", "z", *rest


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_writes_a_sheet_with_its_title_block(cli, place, name):
    fields = [f for each in ("project=River Street 5", "author=A. Planner", "paper=a3") for f in ("--sheet", each)]
    files = ["a.svg", "a.pdf"] if name == "viewshed" else ["a.svg"]  # contract/test_same_bytes.py writes the others
    assert cli(*words(name), *(word for file in files for word in ("--map", file)), *fields).code == 0
    text = (place / "a.svg").read_text()
    assert "River Street 5" in text and "A. Planner" in text and "Antumbra" in text
    sides = [round(float(text.split(f'{side}="')[1].split("pt")[0]) / 72 * 25.4, 1) for side in ("width", "height")]
    assert sorted(sides) == sorted(PAPERS["a3"])
    assert name == "skyline" or "1:" in text
    labelled = "windows.csv" in COMMANDS[name] and name in ("sun", "los")
    assert (">W1<" in text) == labelled
    assert name != "viewshed" or (place / "a.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize("name", COMMANDS)
@pytest.mark.parametrize("field, message", [("scal=1:5", "there is no such field"), ("scale=1:1", "scale")])
def test_wrong_fields_are_one_line_and_leave_no_file(cli, place, name, field, message):
    done = cli(*words(name), "--map", "a.pdf", "--sheet", field, "--quiet")
    assert done.code == 2 and message in done.err and len(done.err.strip().splitlines()) == 1
    assert sorted(each.name for each in place.iterdir()) == ["site.obj", "windows.csv"]


@pytest.mark.parametrize("name", ["sun", "sun per building", "viewshed", "visible"])
def test_an_impossible_scale_is_refused_before_the_work(cli, place, monkeypatch, name):
    from antumbra.cli.study_run import StudyRun

    monkeypatch.setattr(StudyRun, "timed", lambda run, work: pytest.fail("the study has begun"))
    done = cli(*words(name), "--map", "a.pdf", "--sheet", "scale=1:1")
    assert done.code == 2 and "1:1 does not fit on A4; the extent of" in done.err


def test_a_sheet_without_a_map_is_refused(cli, place):
    done = cli(*words("viewshed"), "--sheet", "paper=a3", "-o", "a.csv")
    assert done.code == 2 and "--sheet is for map sheets; give --map FILE, too" in done.err
    assert not (place / "a.csv").exists()


def test_the_sources_are_the_files_of_the_arguments(cli, place, monkeypatch):
    import antumbra.city.sheets.sheet as sheet

    seen = []
    monkeypatch.setattr(sheet, "source_facts", lambda about, scene, files, licence: seen.extend(files) or [])
    assert cli(*words("los"), "--map", "a.pdf", "-o", "a.csv").code == 0
    assert [each.name for each in seen] == ["site.obj", "windows.csv"]
