"""Compares hours of sun with Embree: sensors and the hourly suns of a year, with the same rays in the same process.

    python benchmarks/sun.py [scene] [--sensors N] [--slice N] [--rounds N] [--threads N] [--json FILE]

The scene is a file with +Z up (default: the Delft of $ANTUMBRA_SCENES, else the procedural city, +Y up). A grid of
about N sensors covers all surfaces. Timed alternately:

- `sun_hours`: the whole call, from sensors to the table of hours. Its rate counts all pairs of sensor and sun.
- `embree numpy`: the pairs with the sun above the surface for every k-th sensor, from NumPy arrays of rays, through
  compiled loops over rtcOccluded1 on the same number of threads, to hours in NumPy. Its rate counts all pairs of these
  sensors.
- `embree bare`: only the calls of rtcOccluded1, without writing and reading the records.

The resulting hours are compared.
"""

import json
import statistics
import time
from pathlib import Path

import numpy as np

import antumbra as at
from antumbra.city.sun.sun_visibility import sum_suns, sun_query
from antumbra.kernels.parallel import thread_count
from antumbra.query.receivers import Receivers
from antumbra.sun.sun_positions import parse_days, zone_of
from common import SCENES, arguments, has_embree, machine
from peers import embree
from peers.embree import occluded_of, trace, write
from peers.ray_contest import ray_set

PLACE = at.Place(52.0, 4.36, timezone="Europe/Amsterdam")
DAYS = "year:2026"


def opened(path: Path | None):
    """(name, scene)."""
    path = path or SCENES / "delft_city" / "scene.glb"
    if path.exists():
        return path.parent.name if path.stem == "scene" else path.stem, at.load(path, up="z")
    return "city", at.procedural("city", triangles=100_000)


def grid(scene, count: int):
    """A grid of about `count` sensors on the surfaces."""
    area = at.face_sensors(scene).areas.sum()
    return at.grid_sensors(scene, float(np.sqrt(area / count)))


def embree_hours(scene, sensors, suns, every: int, threads: int):
    """(hours of every k-th sensor, total seconds, seconds of Embree's calls)."""
    start = time.perf_counter()
    points, normals = sensors.points[::every], sensors.normals[::every]
    origins = Receivers.on_surface(points, normals, scene.origin).origins[0]
    far = 4.0 * float(np.linalg.norm(np.diff(scene.bounds, axis=0)))
    row, sun = np.nonzero(normals @ suns.directions.T > 0.0)
    rays = ray_set(origins[row], (far * suns.directions).astype(np.float32)[sun], 1.0)
    device = embree.Device(threads)
    tree = embree.EmbreeScene(device, scene.triangles(0.0).vertices)
    records = write(rays, np.arange(len(row), dtype=np.int32), threads=threads)
    middle = time.perf_counter()
    trace(tree, records, True, threads)
    bare = time.perf_counter() - middle
    lit = ~occluded_of(rays, records)
    hours = np.bincount(row, suns.hours[sun] * lit, len(points))
    seconds = time.perf_counter() - start
    tree.close()
    device.close()
    return hours, seconds, bare


def main() -> None:
    parser = arguments(__doc__)
    parser.set_defaults(rounds=1)
    parser.add_argument("--sensors", type=int, default=1_000_000)
    parser.add_argument("--slice", type=int, default=4000, help="sensors for Embree")
    options = parser.parse_args()
    threads = thread_count(options.threads)
    name, scene = opened(options.scene[0] if options.scene else None)
    sensors = grid(scene, options.sensors)
    suns = at.suns_of(PLACE, at.times_of(parse_days(DAYS), zone_of(PLACE), 60), scene.up)
    every = max(1, len(sensors) // options.slice)
    query = sun_query(scene, sensors, suns, np.empty((len(suns.hours), 0), np.int64), 1, threads=threads)
    sum_suns(query._replace(sensors=sensors.part(0, 64)))  # compiles, and builds the tree
    seconds: dict[str, list[float]] = {}
    hours = peer = None
    for _ in range(options.rounds):
        start = time.perf_counter()
        hours = sum_suns(query).hours
        seconds.setdefault("sun_hours", []).append((time.perf_counter() - start) / (len(sensors) * len(suns.hours)))
        if has_embree():
            peer, *spent = embree_hours(scene, sensors, suns, every, threads)
            for method, each in zip(("embree numpy", "embree bare"), spent):
                seconds.setdefault(method, []).append(each / (len(peer) * len(suns.hours)))
    base = statistics.median(seconds["sun_hours"])
    rows = [
        {
            "scene": name,
            "triangles": scene.n_triangles,
            "sensors": len(sensors),
            "suns": len(suns.hours),
            "threads": threads,
            "method": method,
            "million_pairs_per_second": 1e-6 / statistics.median(each),
            "seconds_for_all": statistics.median(each) * len(sensors) * len(suns.hours),
            "we_are_faster": statistics.median(each) / base,
            "other_hours": None if peer is None else int((peer != hours[::every]).sum()),
            "of_sensors": None if peer is None else len(peer),
        }
        for method, each in seconds.items()
    ]
    print("scene            method        sensors    suns  Mpairs/s  s for all   ratio  other hours")
    for r in rows:
        other = "" if r["other_hours"] is None else f"{r['other_hours']} of {r['of_sensors']}"
        head = f"{r['scene']:16s} {r['method']:12s} {r['sensors']:9,d} {r['suns']:6,d}"
        rate = f"{r['million_pairs_per_second']:9.2f} {r['seconds_for_all']:10.1f} {r['we_are_faster']:7.2f}"
        print(f"{head} {rate}  {other}")
    if options.json:
        options.json.write_text(json.dumps({"machine": machine(threads), "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
