"""Every job on a store: the results of the scene in memory, or one line that names the cure."""

import csv
import json
import re

import numpy as np
import OpenEXR
import pytest
import rasterio
from PIL import Image
from pyarrow import parquet

import antumbra as at
from antumbra.base.command_registry import COMMANDS
from antumbra.city.sun import sun_visibility
from antumbra.store.system_resources import resident_memory
from city_files import CUBE, building, city, put
from cli.test_shards import CITY, JOBS, TARGETS

CORNERS = CUBE[[0, 3, 2, 1, 4, 5, 6, 7]]  # in the order in which faces use them, as a store finds them
FACES = [[0, 1, 2, 3], [4, 5, 6, 7], [0, 3, 5, 4], [3, 2, 6, 5], [2, 1, 7, 6], [1, 0, 4, 7]]
DAY = ("--days", "2026-03-21", "--step", 240)
HERE = ("--at", "2026-06-21T15:00", "--timezone", "+02:00")
BOXES = {  # sizes, and lower corners
    "house": ((8, 8, 6), (0, 0, 0)),
    "hall": ((8, 12, 4), (20, 0, 0)),
    "tower": ((4, 4, 12), (21, 1, 4)),
    "street": ((40, 4, 0.25), (-5, -8, -0.25)),
    "tree": ((3, 3, 6), (10, 20, 0)),
    "land": ((60, 60, 0.5), (-20, -20, -1)),
}
KINDS = {"tower": "BuildingPart", "street": "Road", "tree": "SolitaryVegetationObject", "land": "TINRelief"}

TREES = "trees.csv?height=h&radius=r"
LEAVES = f"{TREES}&transmittance=0.6/0.6/0.5/0.3/0.1/0.1/0.1/0.1/0.2/0.4/0.5/0.6"
EYES = "--sensors", "raster:4+1.6", "--observer", "15,5,1.7"
PICTURE = "--camera", "45,-30,30:10,5,2", "--size", "64x48", "--spp", 4, "--adaptive"

TOWN = {
    "sun per building": ("sun", *DAY, "--sensors", "face", "--per", "building", "-o", "a.csv"),
    "sun on faces": ("sun", *DAY, "--sensors", "grid:4", "--facing", "100:260", "-o", "a.npz"),
    "sun at vertices": ("sun", *DAY, "--sensors", "vertex", "-o", "a.csv", "-o", "a.png"),
    "sun of a raster": ("sun", *DAY, "--sensors", "raster:4", "-o", "a.csv", "-o", "a.tif"),
    "map of the sun": ("sun", *DAY, "--sensors", "raster:4", "--map", "a.png"),
    "gardens": ("sun", *DAY, "--areas", "area.geojson", "-o", "a.csv"),
    "shadow of objects": ("shadow", *HERE, "--per", "object", "-o", "a.geojson"),
    "shadow of casters": ("shadow", *HERE, "--casters", "Building*", "-o", "a.geojson"),
    "calendar": ("calendar", "--points", "targets.csv", "--days", "2026-03-21", "-o", "a.csv"),
    "route": ("route", "--line", "line.geojson", "--spacing", 6, "--days", "2026-03-21", "-o", "a.csv"),
    "modules": ("pv", "--modules", "modules.csv", *DAY, "--timezone", "+01:00", "-o", "a.csv"),
    "skyline": ("skyline", "--point", "15,5,1.5", "--azimuth-step", 30, "-o", "a.csv"),
    "curved earth": ("skyline", "--point", "15,5,1.5", "--azimuth-step", 30, "--curvature", "-o", "a.csv"),
    "lines of sight": ("los", "--from", "15,5,1.5", "--targets", "targets.csv", "-o", "a.csv"),
    "an object as target": ("visible", "--sensors", "raster:8+1.6", "--object", "tower", "-o", "a.csv"),
    "factors of buildings": ("view-factors", "--per", "building", "--samples", 256, "-o", "a.csv"),
    "factors of objects": ("view-factors", "--per", "object", "--samples", 256, "-o", "a.csv"),
    "matrix": ("matrix", "--sensors", "face", "-o", "a.npy", "--counts", "c.csv"),
    "trees": ("sun", *DAY, "--trees", TREES, "--sensors", "raster:4", "-o", "a.tif"),
    "leaves": ("sun", *DAY, "--trees", LEAVES, "--sensors", "raster:4", "--sky-view", 32, "-o", "a.csv"),
    "view with trees": ("viewshed", *EYES, "--trees", TREES, "-o", "a.tif"),
    "skyline with trees": ("skyline", "--point", "15,5,1.5", "--azimuth-step", 30, "--trees", TREES, "-o", "a.csv"),
    "shadow of trees": ("shadow", *HERE, "--trees", TREES, "--cell", 4, "-o", "a.tif"),
    "sight past trees": ("los", "--from", "15,5,1.5", "--targets", "targets.csv", "--trees", TREES, "-o", "a.csv"),
    "picture with trees": ("render", *PICTURE, "--trees", LEAVES, "-o", "a.png", "-o", "a.exr"),
    "bake": ("bake", "-o", "a.glb", "--spp", 16),
    "light of a bake": ("bake", "-o", "a.glb", "--what", "light", "--bounces", 1, "--spp", 4),
    "page": ("page", "-o", "a.html", "--date", "2026-03-21"),
}
"""Jobs on a town of objects."""

REFUSED = {
    "types of surfaces": ("sun", *DAY, "--sensors", "face", "--surfaces", "WallSurface", "-o", "a.csv"),
    "sun per surface": ("sun", *DAY, "--sensors", "face", "--per", "surface", "-o", "a.csv"),
    "factors of surfaces": ("view-factors", "--per", "surface", "-o", "a.csv"),
    "changes": ("sun", *DAY, "--remove", "house", "-o", "a.csv"),
}
"""Jobs that need what a store does not have."""

CURES = {"changes": "source file"}

INTERACTIVE = {"view"}


def town_file(folder, offset=0.0, file="a.city.json"):
    vertices = np.concatenate([CORNERS / CUBE.max() * size + place for size, place in BOXES.values()])
    vertices = vertices + offset
    objects = {}
    for k, name in enumerate(BOXES):
        boundaries = [[[[8 * k + corner for corner in face]] for face in FACES]]
        shape = {"type": "Solid", "lod": "1", "boundaries": boundaries}
        objects[name] = building(shape, kind=KINDS.get(name, "Building"))
    objects["hall"]["children"], objects["tower"]["parents"] = ["tower"], ["hall"]
    return put(folder, city(objects, vertices, crs=None), file)


@pytest.fixture(scope="module")
def stores(tmp_path_factory):
    """The folder with the town, and the stores of the town and the procedural city."""
    folder = tmp_path_factory.mktemp("stores")
    at.build_store(at.load(town_file(folder)), folder / "a.antumbra", chunk=16)
    # In float64, as plants are, which then leave the frame as it is.
    at.build_store(at.load(town_file(folder, [0.1, 0.1, 0.0], "b.city.json")), folder / "b.antumbra", chunk=16)
    at.build_store(at.procedural("city", triangles=3000), folder / "city.antumbra", chunk=256)
    (folder / "targets.csv").write_text(TARGETS)
    (folder / "modules.csv").write_text("id,x,y,z,tilt,azimuth,width,height\nm,4,4,6.5,30,180,1,1\n")
    (folder / "trees.csv").write_text("x,y,h,r\n30,30,6,2\n14,6,9,3\n16,9,5,2\n-10,3,7,1.5\n")
    square = [[1, -5], [9, -5], [9, -3], [1, -3], [1, -5]]
    for name, kind, at_ in (("line", "LineString", [[-4, 4], [14, 4], [14, 190]]), ("area", "Polygon", [square])):
        feature = {"type": "Feature", "properties": {}, "geometry": {"type": kind, "coordinates": at_}}
        (folder / f"{name}.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": [feature]}))
    return folder


def outputs(cli, monkeypatch, stores, folder, words):
    """The files that a command writes in a folder of its own, beside copies of the inputs."""
    folder.mkdir()
    inputs = [path for path in stores.iterdir() if path.suffix in (".csv", ".geojson", ".json", ".antumbra")]
    for path in inputs:
        (folder / path.name).symlink_to(path)
    monkeypatch.chdir(folder)
    done = cli(*words, "--quiet")
    assert done.code == 0, done
    names = {path.name for path in inputs} | {"_manifest.json"}
    made = [path for path in folder.rglob("*") if path.is_file() and path.name not in names]
    return {str(path.relative_to(folder)): values(path) for path in made}


NOT_IN_STORES = {"about", "surface", "type"}
"""Metadata, which has digests of scenes, and semantic surfaces."""


def without(values):
    return {name: value for name, value in values.items() if name not in NOT_IN_STORES}


def values(path):
    """The values in a file of results, without its metadata, which name the file of the scene."""
    if path.suffix == ".npz":
        return without({name: repr(array.tolist()) for name, array in np.load(path).items()})
    if path.suffix == ".csv":
        with path.open(newline="") as stream:
            return [without(row) for row in csv.DictReader(stream)]
    if path.suffix == ".parquet":
        return without({name: repr(column) for name, column in parquet.read_table(path).to_pydict().items()})
    if path.suffix == ".tif":
        with rasterio.open(path) as raster:
            bands = {name: raster.read(k).tobytes() for k, name in enumerate(raster.descriptions, 1)}
        return without(bands), raster.transform
    if path.suffix == ".png":
        return Image.open(path).tobytes()
    if path.suffix == ".exr":
        with OpenEXR.File(str(path), separate_channels=True) as file:
            return without({name: channel.pixels.tobytes() for name, channel in file.channels().items()})
    if path.suffix == ".html":
        return re.sub(r'"digest":"[0-9a-f]*"', "", path.read_text())  # of a store, it is that of its chunks
    if path.suffix == ".json":
        record = json.loads(path.read_text())
        return [(each["camera"], each["lights"]) for each in record.get("frames", ())]
    return path.read_bytes()


def same(one, other):
    """Check that a job gave the same files."""
    assert one == other and one


PLACE = ("--latitude", 52, "--longitude", 4.36)


def words_of(job, scene):
    command, *more = TOWN[job]
    scene = scene.replace("a.", "b.") if "--trees" in more else scene
    place = PLACE if command in ("sun", "shadow", "calendar", "route", "pv") else ()
    return command, scene, *place, *more


@pytest.mark.parametrize("job", TOWN)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_job_on_a_town_of_objects_gives_the_results_of_the_scene_in_memory(cli, monkeypatch, tmp_path, stores, job):
    whole = outputs(cli, monkeypatch, stores, tmp_path / "whole", words_of(job, "a.city.json"))
    limit = resident_memory() + (1 << 30)  # of this process, in which many tests may have run
    limited = *words_of(job, "a.antumbra"), "--max-memory", limit
    paged = outputs(cli, monkeypatch, stores, tmp_path / "paged", limited)
    same(whole, paged)


ON_CITY = {job: words for job, words in JOBS.items() if words[1] == CITY and words[0] != "build"}


@pytest.mark.parametrize("job", ON_CITY)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_job_on_a_city_gives_the_results_of_the_scene_in_memory(cli, monkeypatch, tmp_path, stores, job):
    command, _, *more = ON_CITY[job]
    whole = outputs(cli, monkeypatch, stores, tmp_path / "whole", (command, CITY, *more))
    paged = outputs(cli, monkeypatch, stores, tmp_path / "paged", (command, "city.antumbra", *more))
    same(whole, paged)


@pytest.mark.parametrize("job", REFUSED)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_what_a_store_lacks_is_refused_in_one_line(cli, monkeypatch, tmp_path, stores, job):
    command, *more = REFUSED[job]
    place = PLACE if command in ("sun",) else ()
    monkeypatch.chdir(stores)
    before = set(stores.iterdir())
    cli(command, "a.antumbra", *place, *more, "-q").refused("store", CURES.get(job, "the file that it was built from"))
    assert set(stores.iterdir()) == before


def test_the_walk_has_every_job():
    walked = {words[0] for words in (*TOWN.values(), *ON_CITY.values(), *REFUSED.values())}
    groups = "Pictures", "Sun and shadow", "Sight"
    assert walked | INTERACTIVE == {name for name, each in COMMANDS.items() if each.group in groups}


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_shards_of_sensors_on_faces_of_a_store_merge_to_the_whole(cli, monkeypatch, tmp_path, stores):
    monkeypatch.setattr(sun_visibility, "SENSORS_PER_PART", 50)
    words = words_of("sun on faces", "a.antumbra")
    whole = outputs(cli, monkeypatch, stores, tmp_path / "whole", words)
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "a.antumbra").symlink_to(stores / "a.antumbra")
    monkeypatch.chdir(tmp_path / "parts")
    for k in range(3):
        done = cli(*words, "--shard", f"{k}/3", "--json").json()
        assert done["parts"] == done["done"] > 1
    assert cli("merge", "a.shards", "-q").code == 0
    assert values(tmp_path / "parts" / "a.npz") == whole["a.npz"]
