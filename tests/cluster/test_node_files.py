"""Files that arguments name go to nodes that lack them."""

import pickle
import re
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import get_type_hints

import numpy as np
import pytest
import rasterio

import antumbra as at
from antumbra.city.sight.matrix_command import MatrixCommand
from antumbra.city.sight.sight_options import MatrixOptions
from antumbra.city.sun.sun_command import SunCommand
from antumbra.city.sun.sun_options import SunOptions
from antumbra.cli.app import program
from antumbra.cli.study_run import start_on_node
from antumbra.cluster import node_files, ray_executor, ray_workers
from antumbra.cluster.node_files import INPUTS, files_in, with_files


def put_raster(folder, name="dem.tif"):
    place = rasterio.transform.from_origin(-20.0, 20.0, 10.0, 10.0)
    with rasterio.open(folder / name, "w", "GTiff", 4, 4, 1, dtype="float32", transform=place) as file:
        file.write(np.zeros((1, 4, 4), np.float32))


@pytest.mark.parametrize(
    "argument, path, there",
    [
        ({"sensors": "raster:dem.tif"}, "dem.tif", "raster:/n/x.tif"),
        ({"sensors": "raster:dem.tif+1.6"}, "dem.tif", "raster:/n/x.tif+1.6"),
        ({"targets": "raster:dem.tif@-2"}, "dem.tif", "raster:/n/x.tif@-2"),
        ({"sensors": "dem.tif"}, "dem.tif", "/n/x.tif"),
        ({"scene": "city.json?lod=2.2"}, "city.json", "/n/x.tif?lod=2.2"),
        ({"areas": Path("city.json")}, "city.json", Path("/n/x.tif")),
        ({"sensors": "raster:2"}, None, None),
        ({"sensors": "raster:none.tif"}, None, None),
        ({"sensors": "face", "areas": {"a": [[0, 0], [1, 0], [0, 1]]}, "sky": 3}, None, None),
        ({"what": "light", "plan": "auto"}, None, None),  # also where folders have these names
    ],
)
def test_files_in_arguments(tmp_path, monkeypatch, argument, path, there):
    monkeypatch.chdir(tmp_path)
    for name in ("dem.tif", "city.json", "light", "auto"):
        Path(name).touch()
    found = files_in(argument)
    name = next(iter(argument))
    assert found == ({} if path is None else {name: Path(path)})
    assert with_files(argument, {each: "/n/x.tif" for each in found}) == ({} if path is None else {name: there})


def test_each_file_of_a_list_is_replaced(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("west.tif", "east.tif"):
        Path(name).touch()
    given = {"terrain": [Path("west.tif"), Path("none.tif"), Path("east.tif")], "height": "h"}
    found = files_in(given)
    assert found == {"terrain 0": Path("west.tif"), "terrain 2": Path("east.tif")}
    there = with_files(given, {key: f"/n/{path}" for key, path in found.items()})
    assert there == {"terrain": [Path("/n/west.tif"), Path("none.tif"), Path("/n/east.tif")]}


@pytest.fixture
def told(tmp_path, monkeypatch):
    """Begins a job on a node that has none of the files of the driver; gives the units and the fetched files."""

    def run(prepare, paths, lost=True):
        fetched = []

        def read(path, offset):
            fetched.append(Path(path).name)
            return node_files.piece_of(path.removeprefix("/gone"), offset)

        wanted = {name: node_files.input_of(Path(path)) for name, path in paths.items()}
        if lost:
            wanted = {name: each._replace(path=f"/gone{each.path}") for name, each in wanted.items()}
        with monkeypatch.context() as patched:
            patched.setattr(node_files.tempfile, "tempdir", str(tmp_path))
            patched.setattr(ray_workers, "precompile_plan_kernels", lambda plan: None)
            patched.chdir(tmp_path)
            worker = ray_workers.Node(1)
            found = worker.begin(ray_workers.NodeWork(prepare, wanted, "bsah+single", "a.shards"), read).signature
            worker.leave()
        return found, fetched

    return run


CITY = "procedural:city?triangles=1000"
SUN = SunCommand(scene=CITY, sensors="raster:dem.tif+1.6", latitude=52.0, longitude=4.36, output=[Path("a.csv")],
                 options=SunOptions(days="2026-03-21", plan="bsah+single"))  # fmt: skip
MATRIX = MatrixCommand(
    scene=CITY, sensors="raster:dem.tif+1.6", output=Path("a.npy"), options=MatrixOptions(plan="bsah+single")
)


@pytest.mark.parametrize("given", [SUN, MATRIX])
def test_rasters_of_sensors_are_fetched(tmp_path, monkeypatch, told, given):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    put_raster(tmp_path / "here")
    prepare = partial(start_on_node, pickle.loads(pickle.dumps(given)))
    paths = {name: str(path) for name, path in files_in(vars(given)).items()}
    far, fetched = told(prepare, paths)
    assert fetched == ["dem.tif"] and far[0][1]
    near, fetched = told(prepare, paths, lost=False)
    assert not fetched and far == near  # units have digests of the sensors in their names


def test_rasters_of_the_ground_are_fetched(tmp_path, monkeypatch, told):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    put_raster(tmp_path / "here")
    put_raster(tmp_path / "here", "roofs.tif")
    given = replace(SUN, scene="roofs.tif", terrain=[Path("dem.tif")], sensors="raster", quiet=True)
    paths = {name: str(path) for name, path in files_in(vars(given)).items()}
    found, fetched = told(partial(start_on_node, given), paths)
    assert set(fetched) == {"roofs.tif", "dem.tif"} and found[0][1]


def test_files_of_calls_are_fetched(tmp_path, monkeypatch, told):
    monkeypatch.chdir(tmp_path)
    put_raster(tmp_path)
    at.build_store(at.procedural("city", triangles=1000), "city.antumbra")
    given = {"days": "2026-03-21", "place": at.Place(52.0, 4.36), "plan": "bsah+chcrt"}
    args = ("raster:dem.tif+1.6",)
    named = ray_executor.named_arguments(at.sun_hours, Path("city.antumbra"), args, given)
    prepare = partial(ray_executor.prepare_call, ("antumbra.city.sun.sun_hours", "sun_hours"), args, given)
    found, fetched = told(prepare, files_in(named))
    assert set(fetched) == {"city.antumbra", "dem.tif"} and found[0][0] >= 1
    with pytest.raises(at.InputError, match="sun_hours: got an unexpected keyword argument 'dayz'"):
        at.cluster.run(at.sun_hours, "city.antumbra", dayz=3)


def test_a_raster_of_other_files_is_not_fetched(tmp_path):
    (tmp_path / "dem.vrt").write_text("<VRTDataset/>")
    wanted = node_files.input_of(tmp_path / "dem.vrt")._replace(path="/gone/dem.vrt")
    with pytest.raises(at.InputError, match=r"dem\.vrt: is not on node .*, and names other files; share it"):
        node_files.local_path(wanted, node_files.piece_of, tmp_path)


def test_all_arguments_that_name_files_are_inputs():
    """Of all commands that run on a cluster."""
    told = set()
    for command in program().registered_commands:
        hints = get_type_hints(command.callback, include_extras=True)
        for name, hint in hints.items() if "ray" in hints else ():
            (info, *_) = getattr(hint, "__metadata__", (None,))
            words = f"{info.help} {info.metavar}" if info else ""
            reads = not hasattr(getattr(info, "callback", None), "writes") and "bool" not in str(hint)
            if reads and ("Path" in str(hint) or re.search(r"\bFILE\b|file of points|--sensors|\.hdr|SCENE$", words)):
                told.add(name)
    assert told - {"merge"} == set(INPUTS)  # folders of parts, which only the command itself reads
