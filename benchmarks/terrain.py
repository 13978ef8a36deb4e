"""Viewsheds and hours of sun over rasters of heights, beside GDAL's `gdal_viewshed`.

    python benchmarks/terrain.py [--sizes N ...] [--step MINUTES] [--rounds N] [--threads N] [--json FILE]

The surface is fractal relief, N x N cells of 5 m. In alternation:

- `viewshed`: one observer, 10 m above the surface, sees which cells. The scene is in memory; its result has a table.
- `least height`: the same, with the least visible height of each cell.
- `gdal_viewshed`: the program, with files, if it is installed (Debian: gdal-bin); its CPU time includes reading and
  writing. It interpolates heights between cells, so its cells differ; the share of equal ones is printed.
- `sun hours`: a day at 15 minutes, on all cells.

Times are seconds of CPU of the whole call, so they do not depend on the number of cores; wall time stands beside them.
"""

import json
import resource
import shutil
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import antumbra as at
from antumbra.base.extras import import_extra
from antumbra.kernels.parallel import thread_count
from common import arguments, installed, machine

CELL, WEST, NORTH = 5.0, 84000.0, 446000.0
EYE = 10.0
DAY = "2026-03-21"


def relief(n: int):
    """(n, n) float32: heights with a fractal spectrum, about a third as high as the surface is wide in cells."""
    random = np.random.default_rng(0)
    wave = np.hypot(np.fft.rfftfreq(n)[None], np.fft.fftfreq(n)[:, None])
    phases = np.exp(2j * np.pi * random.random(wave.shape))
    heights = np.fft.irfft2(phases / np.maximum(wave, 1.0 / n) ** 1.9, s=(n, n))
    return ((heights - heights.min()) / np.ptp(heights) * 0.35 * n).astype(np.float32)


def program() -> str:
    """The path of gdal_viewshed."""
    found = shutil.which("gdal_viewshed")
    if found is None:
        raise at.InputError("gdal_viewshed is not installed; on Debian, apt-get install gdal-bin")
    return found


def write_dem(path: Path, heights) -> None:
    rasterio = import_extra("rasterio", "benchmarks/terrain.py", "gis")
    place = rasterio.Affine(CELL, 0.0, WEST, 0.0, -CELL, NORTH)
    options = {"height": len(heights), "width": len(heights), "count": 1, "dtype": "float32", "crs": "EPSG:28992"}
    with rasterio.open(path, "w", driver="GTiff", transform=place, **options) as file:
        file.write(heights, 1)


def by_gdal(dem: Path, eye: tuple[float, float]):
    """(n, n) bool: the cells that gdal_viewshed finds visible, on a flat earth."""
    rasterio = import_extra("rasterio", "benchmarks/terrain.py", "gis")
    out = dem.with_name("seen.tif")
    place = ["-ox", str(eye[0]), "-oy", str(eye[1]), "-oz", str(EYE), "-md", "0", "-cc", "0"]
    subprocess.run([program(), "-q", *place, str(dem), str(out)], check=True)
    with rasterio.open(out) as file:
        return file.read(1) > 0


def cpu() -> float:
    """Seconds of CPU of this process and of finished children."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def measure(tasks: dict[str, Callable[[], object]], rounds: int):
    """(seconds of CPU, wall seconds, results) by name; the tasks alternate, after one round to compile."""
    clocks = {name: ([], []) for name in tasks}
    results = {name: task() for name, task in tasks.items()}
    for _ in range(rounds):
        for name, task in tasks.items():
            start, used = time.perf_counter(), cpu()
            task()
            clocks[name][0].append(cpu() - used)
            clocks[name][1].append(time.perf_counter() - start)
    return clocks, results


def rows_of(n: int, options, threads: int, folder: Path) -> list[dict]:
    heights = relief(n)
    scene = at.from_raster((heights, (CELL, 0.0, WEST, 0.0, -CELL, NORTH), "EPSG:28992"))
    eye = (WEST + CELL * 0.43 * n, NORTH - CELL * 0.61 * n)
    given = {"on_surface": True, "eye_height": EYE, "threads": threads}
    look = lambda **more: at.viewshed(scene, "raster", (*eye, 0.0), **given, **more).table["seen"].reshape(n, n) > 0
    tasks = {
        "viewshed": look,
        "least height": lambda: look(least_height=True),
        "sun hours": lambda: at.sun_hours(scene, "raster", DAY, step=options.step, threads=threads)["sun_hours"],
    }
    if installed(program):
        write_dem(folder / "dem.tif", heights)
        tasks["gdal_viewshed"] = lambda: by_gdal(folder / "dem.tif", eye)
    clocks, results = measure(tasks, options.rounds)
    rows = []
    for name, (used, walls) in clocks.items():
        row = {"cells": n * n, "method": name, "threads": 1 if name == "gdal_viewshed" else threads}
        row |= {"cpu_seconds": statistics.median(used), "wall_seconds": statistics.median(walls)}
        if name == "gdal_viewshed":
            row["equal"] = float((results[name] == results["viewshed"]).mean())
        rows.append(row)
    return rows


def main() -> None:
    parser = arguments(__doc__)
    parser.set_defaults(rounds=5)
    parser.add_argument("--sizes", type=int, nargs="+", default=[1024], help="cells along each side")
    parser.add_argument("--step", type=float, default=15.0, help="minutes between suns")
    options = parser.parse_args()
    threads = thread_count(options.threads)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for n in options.sizes:
            rows += rows_of(n, options, threads, Path(folder))
    print("     cells  method         CPU s   wall s  ns/cell")
    for r in rows:
        rate = f"{r['cpu_seconds']:8.3f} {r['wall_seconds']:8.3f} {1e9 * r['cpu_seconds'] / r['cells']:8.0f}"
        more = f"  {100.0 * r['equal']:.2f} % of the cells are equal" if "equal" in r else ""
        print(f"{r['cells']:10,d}  {r['method']:13s} {rate}{more}")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    print(f"greatest memory of this process: {peak:.2f} GB", file=sys.stderr)
    if options.json:
        options.json.write_text(json.dumps({"machine": machine(threads), "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
