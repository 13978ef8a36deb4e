"""Every output of every command has the same bytes in another process, folder, second and order of hashes."""

import json
import os
import subprocess
import sys
from datetime import UTC, datetime

import pytest

import city_files
from cli.test_app_outputs import OUTPUTS
from study_cases import study_cases

CITY = "a.city.json"
TABLES = [f"a{suffix}" for suffix in (".csv", ".parquet", ".gpkg", ".json", ".npz", ".png", ".glb", ".tif")]
MAPS = ["map.pdf", "map.svg", "map.png"]
RASTER = ("--sensors", "raster:2")
EYE = "85000.5,447000.5,9"
SMALL = ("--size", "16", "--spp", "2")
STILL, FILM = ("a.png", "a.exr"), ("a.mp4", "a.webm", "a.gif")
MEASURED = {"render --html", "compare --output", "compare --html"}
"""Outputs that hold measured times."""

JOBS = {
    **{f"render {name}": ("render", CITY, *SMALL, "-o", name) for name in STILL},
    **{f"render {name}": ("render", CITY, *SMALL, "--frames", "0:1", "-o", name) for name in FILM},
    "sun": ("sun", CITY, "--days", "2026-06-21", "--step", "240", *RASTER, "-o", *TABLES, "a.html", "--map", *MAPS,
            "--city-output", "b.city.json", "--matrix", "m.npy"),
    "sun, lines": ("sun", "a.city.jsonl", "--days", "2026-06-21", "--step", "240", "--city-output", "b.jsonl"),
    "shadow": ("shadow", CITY, "--at", "2026-06-21T12:00", "--cell", "1", "-o", "a.gpkg", "a.geojson", "a.parquet",
               "a.tif", "a.html", "--map", *MAPS),
    "bake": ("bake", CITY, "--spp", "2", "-o", "a.glb", "--page", "a.html"),
    "los": ("los", CITY, "--from", EYE, "--to", "85000.5,447009,1", "-o", *(t for t in TABLES if t[1:] in
            (".csv", ".parquet", ".json", ".npz", ".glb")), "--map", *MAPS),
    "viewshed": ("viewshed", CITY, *RASTER, "--observer", EYE, "-o", *TABLES, "a.html", "--map", *MAPS,
                 "--bits", "b.npy"),
    "visible": ("visible", CITY, *RASTER, "--turbine", "85020,447000,0", "--hub-height", "9", "--rotor", "4", "-o",
                *TABLES, "a.html", "--map", *MAPS),
    "matrix": ("matrix", CITY, *RASTER, "-o", "a.npy", "--sparse", "b.npz", "--counts", *TABLES, "a.html", "--map",
               *MAPS),
    "skyline": ("skyline", CITY, "--point", EYE, "-o", "a.csv", "a.json", "a.npz", "a.txt", "--map", *MAPS),
    "polygons": ("viewshed", CITY, *RASTER, "--observer", EYE, "--polygons", "a.gpkg", "a.geojson", "a.parquet",
                 "-o", "a.csv"),
    "calendar": ("calendar", CITY, "--point", EYE, "--days", "2026-06-21", "--step", "60", "-o", "a.csv", "--map",
                 "a.pdf"),
    **{f"calendar{name}": ("calendar", CITY, "--point", EYE, "--days", "2026-06-21", "--step", "60", "--map",
                           f"a{name}", "-o", "a.csv") for name in (".svg", ".png")},
    "route": ("route", CITY, "--line", "route.csv", "--spacing", "5", "--days", "2026-06-21", "--hours", "h.csv", "-o",
              "a.csv", "a.gpkg", "a.parquet", "a.json", "a.npz", "a.png", "--map", *MAPS),
    "pv": ("pv", CITY, "--modules", "route.csv", "--days", "2026-06-21", "-o", "a.csv", "a.parquet"),
    "page": ("page", CITY, "--date", "2026-06-21T12:00", "-o", "a.html"),
    "dataset": ("dataset", CITY, *SMALL, "--random", "1", "-o", "set", "--contact-sheet", "sheet.png"),
    "build": ("build", CITY, "-o", "a.antumbra"),
    "build of tiles": ("build", CITY, "-o", "a.tiles"),
    **{f"scenes {suffix}": ("scenes", "atrium", "--triangles", "1000", "-o", f"a{suffix}")
       for suffix in (".glb", ".obj", ".ply")},
    "culling": ("culling", CITY, "--size", "16", "-o", "a.png"),
    "explain": ("explain", CITY, *SMALL, "--plan", "bsah+single", "-o", "a.png"),
}  # fmt: skip
JOBS |= {case.command: (case.command, CITY, *case.outputs) for case in study_cases() if case.command}
"""Name -> words; several files follow one option."""

SCRIPT = """
import json, os, sys
from antumbra.cli import main
for name, words in json.load(sys.stdin).items():
    os.mkdir(name)
    os.chdir(name)
    for file in os.listdir("../scenes"):
        os.link(f"../scenes/{file}", file)
    code = main(words)
    assert code == 0, (name, code)
    for file in os.listdir("../scenes"):
        os.remove(file)
    os.chdir("..")
"""


def spelled(words):
    """Words with an option before each of the files that follow it."""
    out, option = [], None
    for word in words:
        out += (
            [option, word]
            if option in ("-o", "--map", "--counts", "--polygons") and not word.startswith("-") and out[-1] != option
            else [word]
        )
        option = word if word.startswith("-") else option
    return out


@pytest.fixture(scope="module")
def twice(tmp_path_factory):
    """Two folders with the outputs of all jobs, each made by a process of its own."""
    for package in ("mapbox_earcut", "pvlib", "pyogrio", "pyarrow", "rasterio", "matplotlib", "imageio_ffmpeg"):
        pytest.importorskip(package, reason=f"outputs need {package}: their bytes are NOT compared")
    text = city_files.city(
        {"a": city_files.building(city_files.solid())}, vertices=city_files.CUBE * 4 + (85000, 447000, 0)
    )
    text["metadata"] = {"referenceSystem": "https://www.opengis.net/def/crs/EPSG/0/28992"}
    # Pages without a date show today, which begins earlier in the east: a zone in which it is the same day.
    elsewhere = "Asia/Tokyo" if datetime.now(UTC).hour < 12 else "America/Anchorage"
    folders = []
    for seed in ("1", "20"):
        folder = tmp_path_factory.mktemp(f"seed{seed}")
        (folder / "scenes").mkdir()
        city_files.put(folder / "scenes", text, CITY)
        city_files.put(folder / "scenes", city_files.sequence(text), "a.city.jsonl")
        (folder / "scenes" / "route.csv").write_text("x,y,z\n84990,447002,1\n85020,447012,2\n")
        done = subprocess.run(
            [sys.executable, "-c", SCRIPT], cwd=folder, capture_output=True, text=True,
            input=json.dumps({name: spelled(words) for name, words in JOBS.items()}),
            env=os.environ | {"PYTHONHASHSEED": seed, "TZ": "UTC" if seed == "1" else elsewhere},
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        folders.append(folder)
    return folders


def files_in(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_all_outputs_of_all_commands_are_written():
    written = {f"{words[0]} {word}" for words in map(list, JOBS.values()) for word in words if word.startswith("-")}
    names = {str(output).replace("--output", "-o") for output in OUTPUTS if output.words[0] != "bench"}
    assert names - {name.replace("--output", "-o") for name in MEASURED} <= written


@pytest.mark.parametrize("name", JOBS)
def test_the_bytes_are_the_same(name, twice):
    first, second = (files_in(folder / name) for folder in twice)
    assert first and first.keys() == second.keys()
    assert [file for file in first if first[file] != second[file]] == []


def test_all_suffixes_are_written(twice):
    for output in OUTPUTS:
        if str(output) not in MEASURED and output.words[0] != "bench" and not output.is_folder:
            made = {path.suffix for name, words in JOBS.items() if words[0] == output.words[0]
                    for path in (twice[0] / name).iterdir()}  # fmt: skip
            assert set(output.info.callback.writes()) - {".zarr", ".parquets"} <= made, output  # folders
