"""A small valid file for each reader, made by this project's writers and helpers, for tests that damage it."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import antumbra as at
import city_files
from antumbra.city.sensors.raster_grid import raster_of_file
from antumbra.city.sensors.sensor_files import read_points
from antumbra.city.vegetation.vegetation_table import VegetationOptions, read_vegetation
from antumbra.engine.store_building import build_store
from antumbra.scene.sky import read_environment
from gis_files import buildings, hills, write_buildings, write_raster
from gltf_files import TETRAHEDRON_FACES, everything


def read_scene(path: Path) -> None:
    """Load a scene and evaluate its triangles."""
    scene = at.load(path)
    if isinstance(scene, at.Scene):
        triangles = scene.triangles(0.0)
        assert np.isfinite(triangles.vertices).all() and len(triangles.vertices) == scene.n_triangles


def _read_trees(path: Path) -> None:
    read_vegetation(path, VegetationOptions(radius=2.0))


def _read_lines(path: Path) -> None:
    at.points_along(path, 1.0)


class Seed(NamedTuple):
    """A valid file, the file of it or beside it that is damaged, and the reader."""

    write: Callable[[Path], Any]  # (folder) -> None; writes `path` and the files beside it
    path: str
    read: Callable[[Path], Any] = read_scene
    damaged: str = ""  # "": `path`


def _scene(name: str) -> Callable[[Path], Any]:
    return lambda folder: (folder / name).write_bytes(
        {
            ".glb": lambda: everything().glb(),
            ".gltf": lambda: everything().gltf(),
            ".json": lambda: json.dumps(city_files.everything()).encode(),
            ".jsonl": lambda: city_files.sequence(city_files.everything()).encode(),
        }[Path(name).suffix]()
    )


def _mesh(name: str) -> Callable[[Path], Any]:
    def write(folder: Path) -> None:
        from formats.test_mesh_files import obj_text, ply_binary, ply_text, stl_binary, stl_text

        made = {
            "a.obj": obj_text().encode(), "a.ply": ply_binary(), "b.ply": ply_text().encode(),
            "a.stl": stl_binary(), "b.stl": stl_text().encode(),
        }  # fmt: skip
        made["c.ply"] = ply_text().replace("3 0 1 2", "4 0 1 2 3").encode()
        (folder / name).write_bytes(made[name])

    return write


def _raster(name: str) -> Callable[[Path], Any]:
    return lambda folder: write_raster(folder / name, hills(5, 6).astype(np.float32))


def _masked(folder: Path) -> None:
    import rasterio

    path = write_raster(folder / "a.tif", hills(5, 6).astype(np.float32))
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=False), rasterio.open(path, "r+") as file:
        file.write_mask(np.arange(30).reshape(5, 6) != 7)


def _footprints(name: str) -> Callable[[Path], Any]:
    return lambda folder: write_buildings(folder / name, buildings())


def _lines(folder: Path) -> None:
    import geopandas
    import shapely

    line = shapely.LineString([(0, 0), (10, 0), (10, 5)])
    geopandas.GeoDataFrame(geometry=[line], crs="EPSG:28992").to_file(folder / "a.geojson", driver="GeoJSON")


def _frames(folder: Path) -> None:
    from engine.test_scene_loading_frames import FRAMES

    (folder / "walk").mkdir(exist_ok=True)
    np.save(folder / "walk" / "frames.npy", FRAMES)
    np.save(folder / "walk" / "faces.npy", TETRAHEDRON_FACES)
    (folder / "walk" / "info.json").write_text('{"times": [0, 1, 2]}')


def _store(name: str) -> Callable[[Path], Any]:
    def write(folder: Path) -> None:
        build_store(at.procedural("atrium", triangles=1000), folder / name, progress=False)

    return write


def _points(name: str) -> Callable[[Path], Any]:
    columns = {axis: np.arange(4.0) for axis in "xyz"}

    def write(folder: Path) -> None:
        path = folder / name
        if path.suffix == ".npy":
            np.save(path, np.ones((4, 6)))
        elif path.suffix == ".npz":
            np.savez_compressed(path, **columns)
        elif path.suffix == ".parquet":
            import pyarrow
            import pyarrow.parquet

            pyarrow.parquet.write_table(pyarrow.table(columns), path)
        else:
            path.write_text("x,y,z\n" + "".join(f"{k},{k},{k}.5\n" for k in range(4)))

    return write


def _sky(name: str) -> Callable[[Path], Any]:
    def write(folder: Path) -> None:
        if name.endswith(".hdr"):
            (folder / name).write_bytes(b"#?RADIANCE\n\n-Y 4 +X 8\n" + bytes([90, 80, 70, 129]) * 32)
            return
        from antumbra.picture.image_files import write_exr

        write_exr({each: np.ones((4, 8), np.float32) for each in "RGB"}, folder / name, None)

    return write


def _trees(folder: Path) -> None:
    (folder / "trees.csv").write_text("x,y,height,radius,id\n1,2,9,3,a\n4,5.5,8,2,b\n")


SEEDS = {
    **{name: Seed(_scene(name), name)
       for name in ("a.glb", "a.gltf", "a.city.json", "a.json", "a.city.jsonl", "a.jsonl")},
    **{name: Seed(_mesh(name), name) for name in ("a.obj", "a.ply", "b.ply", "c.ply", "a.stl", "b.stl")},
    **{name: Seed(_raster(name), name) for name in ("a.tif", "a.tiff", "a.vrt", "a.asc")},
    "a.prj": Seed(_raster("a.asc"), "a.asc", damaged="a.prj"),
    "a.tif.msk": Seed(_masked, "a.tif", damaged="a.tif.msk"),
    "source of a VRT": Seed(_raster("a.vrt"), "a.vrt", damaged="a.source.tif"),
    "raster of sensors": Seed(_raster("a.tif"), "a.tif", raster_of_file),
    **{f"a{suffix}": Seed(_footprints(f"a{suffix}"), f"a{suffix}")
       for suffix in (".gpkg", ".geojson", ".fgb", ".parquet", ".shp")},
    **{f"a{suffix} of a.shp": Seed(_footprints("a.shp"), "a.shp", damaged=f"a{suffix}")
       for suffix in (".shx", ".dbf", ".prj", ".cpg")},
    "lines": Seed(_lines, "a.geojson", _read_lines),
    "trees.csv": Seed(_trees, "trees.csv", _read_trees),
    **{f"{name} of frames": Seed(_frames, "walk", damaged=f"walk/{name}")
       for name in ("frames.npy", "faces.npy", "info.json")},
    "a.antumbra": Seed(_store("a.antumbra"), "a.antumbra"),
    "a.tiles": Seed(_store("a.tiles"), "a.tiles"),
    "a tile": Seed(_store("a.tiles"), "a.tiles", damaged="a-0000.antumbra"),
    **{f"points{suffix}": Seed(_points(f"p{suffix}"), f"p{suffix}", read_points)
       for suffix in (".csv", ".npy", ".npz", ".parquet")},
    **{f"sky{suffix}": Seed(_sky(f"s{suffix}"), f"s{suffix}", read_environment) for suffix in (".hdr", ".exr")},
}  # fmt: skip
"""Name -> a seed."""
