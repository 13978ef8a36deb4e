"""A viewshed of a raster of heights, beside the programs that GIS users have for it.

    python benchmarks/viewshed.py [--size N] [--cell METRES] [--rounds N] [--threads N] [--json FILE]

Procedural hills of N x N cells; an observer 30 above the middle looks at the ground of every cell, on a flat earth. In
alternation, each method starts from the file and ends with an array:

- `antumbra`: `from_raster` and `viewshed`: the exact answer for the triangulated surface.
- `gdal_viewshed` of GDAL, in its default mode.
- `r.viewshed` of GRASS, in a temporary project, whose time is part of it.
- `xarray-spatial`: `xrspatial.viewshed`.

Peers that are not installed are left out. Each program interpolates heights between cells in its own way, so the share
of cells with the same answer is printed too, and that of cells that only one of the two sees.
"""

import json
import os
import shutil
import statistics
import subprocess
import tempfile
import time
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
import rasterio
from rasterio.transform import from_origin

import antumbra as at
from antumbra.kernels.parallel import thread_count
from common import arguments, machine

EYE = 30.0
CRS = "EPSG:32631"
WEST, NORTH = 500_000.0, 5_700_000.0


class Hills(NamedTuple):
    """A raster file and the observer in the middle of its middle cell."""

    path: Path
    heights: np.ndarray  # (n, n) float32
    cell: float
    observer: tuple[float, float]  # easting, northing


def hills(folder: Path, size: int, cell: float) -> Hills:
    """Waves of many lengths, the shorter the lower, in a GeoTIFF."""
    random, at_cell = np.random.default_rng(7), np.arange(size) / size
    heights = np.zeros((size, size))
    for octave in range(7):
        for _ in range(3):
            waves, phase = random.uniform(-1.0, 1.0, 2) * 2.0**octave * 3.0, random.uniform(0.0, 2.0 * np.pi)
            heights += np.sin(2.0 * np.pi * np.add.outer(waves[1] * at_cell, waves[0] * at_cell) + phase) / 2.0**octave
    heights = (heights * size * cell / 200.0).astype(np.float32)
    path = folder / "hills.tif"
    shape = {"driver": "GTiff", "width": size, "height": size, "count": 1, "dtype": "float32", "crs": CRS}
    with rasterio.open(path, "w", **shape, transform=from_origin(WEST, NORTH, cell, cell)) as file:
        file.write(heights, 1)
    middle = (size // 2 + 0.5) * cell
    return Hills(path, heights, cell, (WEST + middle, NORTH - middle))


# --- The methods: (rows, columns) bool, the visible cells -------------------------------------------------------------


def by_antumbra(case: Hills, threads: int) -> np.ndarray:
    scene = at.from_raster(case.path)
    east, north = case.observer
    eye = [east, north, float(case.heights[len(case.heights) // 2, len(case.heights) // 2]) + EYE]
    table = at.viewshed(scene, "raster", eye, threads=threads).table
    return table.sensors.on_raster((table["seen"] > 0).astype(np.float64)) == 1.0


def by_gdal(case: Hills, threads: int) -> np.ndarray:
    east, north = case.observer
    output = case.path.with_name("gdal.tif")
    options = ["-ox", east, "-oy", north, "-oz", EYE, "-tz", 0, "-cc", 0, "-md", 0, "-q"]
    run(["gdal_viewshed", *options, case.path, output])
    return band(output) == 255


def by_grass(case: Hills, threads: int) -> np.ndarray:
    east, north = case.observer
    output = case.path.with_name("grass.tif")
    script = case.path.with_name("grass.sh")
    script.write_text(
        f"r.in.gdal -o --quiet input={case.path} output=hills && g.region raster=hills && "
        f"r.viewshed -b --quiet input=hills output=seen coordinates={east},{north} observer_elevation={EYE} "
        f"memory=4000 && r.out.gdal --overwrite --quiet input=seen output={output} type=Byte\n"
    )
    run(["grass", "--tmp-location", CRS, "--exec", "sh", script])
    return band(output) == 1


def by_xarray_spatial(case: Hills, threads: int) -> np.ndarray:
    import xarray
    from xrspatial import viewshed

    n = len(case.heights)
    x, y = WEST + (np.arange(n) + 0.5) * case.cell, NORTH - (np.arange(n) + 0.5) * case.cell
    raster = xarray.DataArray(case.heights.astype(np.float64), coords={"y": y, "x": x}, dims=("y", "x"))
    with warnings.catch_warnings(action="ignore"):
        angles = viewshed(raster, x=case.observer[0], y=case.observer[1], observer_elev=EYE)
    return np.asarray(angles) != -1.0


def has_xarray_spatial() -> bool:
    try:
        import xrspatial  # noqa: F401
    except ImportError:
        return False
    return True


METHODS = {
    "antumbra": (by_antumbra, lambda: True),
    "gdal_viewshed": (by_gdal, lambda: shutil.which("gdal_viewshed") is not None),
    "r.viewshed": (by_grass, lambda: shutil.which("grass") is not None),
    "xarray-spatial": (by_xarray_spatial, has_xarray_spatial),
}
"""Name -> the function, and whether its program is installed."""


def run(words: list) -> None:
    """Run a program of the system, whose libraries must not be those of this Python."""
    environment = {
        key: value for key, value in os.environ.items() if key not in ("PROJ_DATA", "GDAL_DATA", "PYTHONPATH")
    }
    subprocess.run([str(word) for word in words], check=True, capture_output=True, env=environment)


def band(path: Path) -> np.ndarray:
    with rasterio.open(path) as file:
        return file.read(1)


# --- Rounds -----------------------------------------------------------------------------------------------------------


def measured(case: Hills, names: list[str], rounds: int, threads: int) -> list[dict]:
    """A row for each method; the first round, in which kernels are loaded, does not count."""
    times, seen = {name: [] for name in names}, {}
    for k in range(rounds + 1):
        for name in names:
            start = time.perf_counter()
            seen[name] = METHODS[name][0](case, threads)
            if k:
                times[name].append(time.perf_counter() - start)
    exact, rows = seen["antumbra"], []
    for name in names:
        rows.append({
            "method": name,
            "cells": case.heights.size,
            "seconds": statistics.median(times[name]),
            "visible": float(seen[name].mean()),
            "same": float((seen[name] == exact).mean()),
            "only_peer": float((seen[name] & ~exact).mean()),
            "only_antumbra": float((exact & ~seen[name]).mean()),
        })  # fmt: skip
    return rows


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--size", type=int, default=1024, help="cells of a side")
    parser.add_argument("--cell", type=float, default=10.0, help="metres")
    parser.set_defaults(rounds=3)
    args = parser.parse_args()
    threads = thread_count(args.threads)
    names = [name for name, (_, there) in METHODS.items() if there()]
    with tempfile.TemporaryDirectory() as folder:
        rows = measured(hills(Path(folder), args.size, args.cell), names, args.rounds, threads)
    print(f"{'method':16} {'seconds':>8} {'visible':>8} {'same':>8} {'only it':>8} {'only we':>8}")
    for row in rows:
        shares = "".join(f" {row[key]:8.2%}" for key in ("visible", "same", "only_peer", "only_antumbra"))
        print(f"{row['method']:16} {row['seconds']:8.2f}{shares}")
    if args.json:
        args.json.write_text(json.dumps({"machine": machine(threads), "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
