"""Skylines of many points in a city, beside a search by exact any-hit rays and brute force over all edges.

    python benchmarks/skyline.py [scene] [--points N] [--slice N] [--step DEGREES] [--threads N] [--json FILE]

The scene is a file with +Z up (default: the Delft of $ANTUMBRA_SCENES, else the procedural city, +Y up). The points lie
1.6 above the surfaces, at random. In alternation, each method finds elevations along all azimuths:

- `skyline`: the whole call, for all points.
- `rays`: `Scene.occluded`, bisecting the elevation of each azimuth to 0.01 degree, for every k-th point. It finds an
  edge above which rays pass, which is the skyline unless the sky is open below a bridge.
- `brute force`: all edges of all triangles in NumPy, for the same points.

Differences between `skyline` and brute force are printed, in degrees.
"""

import json
import statistics
import time
from pathlib import Path

import numpy as np

import antumbra as at
from antumbra.kernels.parallel import thread_count
from common import SCENES, arguments, machine

HEIGHT = 1.6
BISECTIONS = 14  # of 180 degrees: 0.011 degrees


def opened(path: Path | None):
    """(name, scene)."""
    path = path or SCENES / "delft_city" / "scene.glb"
    if path.exists():
        return path.parent.name if path.stem == "scene" else path.stem, at.load(path, up="z")
    return "city", at.procedural("city", triangles=100_000)


def eyes_of(scene, count: int):
    """(count, 3): random points above the highest surfaces, in float32 as the kernels see them."""
    up = "xyz".index(scene.up)
    low, high = scene.bounds
    points = np.random.default_rng(1).uniform(low, high, (count, 3))
    points[:, up], height = high[up] + HEIGHT, float(high[up] - low[up])
    below = scene.closest_hit(points, -np.eye(3)[up], tmax=height + 2.0 * HEIGHT)
    points[:, up] -= (
        np.where(below.mask, below.t, height + HEIGHT) - HEIGHT
    )  # beside the surfaces: above the lowest one
    return (points - scene.origin).astype(np.float32).astype(np.float64) + scene.origin


def on_map(scene, vectors):
    """Vectors as easting, northing and height."""
    return vectors if scene.up == "z" else vectors[..., [0, 2, 1]] * [1.0, -1.0, 1.0]


def by_rays(scene, eyes, azimuth, threads: int):
    """(n, m) degrees: the elevation at which rays begin to pass, by bisection."""
    low, high = np.full((len(eyes), len(azimuth)), -90.0), np.full((len(eyes), len(azimuth)), 90.0)
    turn = np.radians(azimuth)
    for _ in range(BISECTIONS):
        middle = np.radians((low + high) / 2.0)
        flat = np.cos(middle)
        towards = np.stack([flat * np.sin(turn), flat * np.cos(turn), np.sin(middle)], -1)
        towards = towards if scene.up == "z" else towards[..., [0, 2, 1]] * [1.0, 1.0, -1.0]
        blocked = scene.occluded(eyes[:, None], towards, threads=threads)
        low, high = np.where(blocked, np.degrees(middle), low), np.where(blocked, high, np.degrees(middle))
    return high


def by_edges(corners, eye, azimuth):
    """(m,) degrees: the highest crossing of each vertical half-plane with any edge; -90: none.

    corners : (n, 3, 3) easting, northing, height
    """
    a = (corners - eye).reshape(-1, 3)
    b = (np.roll(corners, -1, 1) - eye).reshape(-1, 3)
    slopes = np.full(len(azimuth), -np.inf)
    for k, angle in enumerate(np.radians(azimuth)):
        s, t = (p[:, 0] * np.cos(angle) - p[:, 1] * np.sin(angle) for p in (a, b))
        cut = (s <= 0.0) != (t <= 0.0)
        point = a[cut] + (s[cut] / (s[cut] - t[cut]))[:, None] * (b[cut] - a[cut])
        r = point[:, 0] * np.sin(angle) + point[:, 1] * np.cos(angle)
        slopes[k] = (point[r > 0.0, 2] / r[r > 0.0]).max(initial=-np.inf)
    return np.degrees(np.arctan(slopes))


def main() -> None:
    parser = arguments(__doc__)
    parser.set_defaults(rounds=3)
    parser.add_argument("--points", type=int, default=10_000)
    parser.add_argument("--slice", type=int, default=50, help="points for rays and brute force")
    parser.add_argument("--step", type=float, default=1.0)
    options = parser.parse_args()
    threads = thread_count(options.threads)
    name, scene = opened(options.scene[0] if options.scene else None)
    eyes = eyes_of(scene, options.points)
    some = eyes[:: max(1, len(eyes) // options.slice)]
    azimuth = np.arange(round(360.0 / options.step)) * options.step
    triangles = scene.triangles()
    corners = on_map(scene, triangles.vertices.astype(np.float64) + triangles.origin)
    seconds: dict[str, list[float]] = {"skyline": [], "rays": [], "brute force": []}
    found = by_search = want = None
    by_rays(scene, some[:1], azimuth[:8], threads)  # compiles, and builds the tree
    for _ in range(options.rounds):
        start = time.perf_counter()
        found = at.skyline(scene, eyes, azimuth_step=options.step, north=0.0, threads=threads)
        seconds["skyline"].append((time.perf_counter() - start) / len(eyes))
        start = time.perf_counter()
        by_search = by_rays(scene, some, azimuth, threads)
        seconds["rays"].append((time.perf_counter() - start) / len(some))
    start = time.perf_counter()
    want = np.array([by_edges(corners, eye, azimuth) for eye in on_map(scene, some)])
    seconds["brute force"].append((time.perf_counter() - start) / len(some))
    ours = found.elevation[:: max(1, len(eyes) // options.slice)]
    sky = ours[:, 0] < 90.0
    errors = {"skyline": 0.0, "rays": np.abs(by_search - ours)[sky], "brute force": np.abs(want - ours)[sky]}
    base = statistics.median(seconds["skyline"])
    rows = [
        {
            "scene": name,
            "triangles": scene.n_triangles,
            "points": len(eyes),
            "azimuths": len(azimuth),
            "threads": threads,
            "method": method,
            "seconds_for_all": statistics.median(each) * len(eyes),
            "we_are_faster": statistics.median(each) / base,
            "compared": int(sky.sum()),
            "greatest_difference": float(np.max(errors[method], initial=0.0)),
            "median_difference": float(np.median(errors[method])),
        }
        for method, each in seconds.items()
    ]
    print("scene            method        points azimuths  s for all   ratio  difference: median, greatest (degrees)")
    for r in rows:
        head = f"{r['scene']:16s} {r['method']:12s} {r['points']:7,d} {r['azimuths']:8,d}"
        rate = f"{r['seconds_for_all']:10.2f} {r['we_are_faster']:7.1f}"
        print(f"{head} {rate}  {r['median_difference']:.2g}, {r['greatest_difference']:.2g}")
    if options.json:
        options.json.write_text(json.dumps({"machine": machine(threads), "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
