"""Compares hours of sun with Radiance, on a floor with boxes: every disagreement, and its distance from an edge.

    python benchmarks/radiance_sun.py [--boxes N] [--sensors N] [--days DAYS] [--threads N] [--json FILE]

Radiance's `rtrace` traces each pair of a sensor and a sun above its surface, from the same receivers in the same
directions; a ray without a hit means no shadow. Its rays are float64, and it reads the same vertices. Pairs on which
the two differ are listed with the angle between the ray and the nearest edge of a box. Requires Radiance:
pip install 'antumbra[all-peers]'
"""

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np

import antumbra as at
from antumbra.query.receivers import Receivers
from antumbra.sun.sun_positions import parse_days, zone_of
from common import installed, machine

PLACE = at.Place(52.0, 4.36, timezone="Europe/Amsterdam")
FAR = 1e4  # metres: distance of suns for Antumbra; the town is smaller than 100
MISS = 1e9  # of rtrace's distances
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


def library():
    """The package of Radiance's programs. Raises InputError if it is not installed."""
    try:
        import pyradiance
    except ImportError:
        raise at.InputError("Radiance is not installed: pip install 'antumbra[all-peers]'") from None
    return pyradiance


def town(boxes: int) -> np.ndarray:
    """(n, 3, 3) float32: a floor with boxes, no two of which share a plane."""
    rng = np.random.default_rng(7)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    faces = np.array([t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))])
    floor = [[[-40, -40, 0], [40, -40, 0], [40, 40, 0]], [[-40, -40, 0], [40, 40, 0], [-40, 40, 0]]]
    size, place = rng.uniform((3, 3, 4), (8, 8, 20), (boxes, 3)), rng.uniform(-30, 30, (boxes, 3)) * (1, 1, 0)
    triangles = [corners[faces] * s + p - (0, 0, 0.01) for s, p in zip(size, place)]
    return np.concatenate([np.array(floor, float), *triangles]).astype(np.float32)


def hit_by_radiance(soup: np.ndarray, origins: np.ndarray, directions: np.ndarray, threads: int) -> np.ndarray:
    """(n,) bool: the rays that hit a triangle, by rtrace."""
    radiance = library()
    with tempfile.TemporaryDirectory() as folder:
        scene = Path(folder) / "town.rad"
        lines = ["void plastic grey 0 0 5 .5 .5 .5 0 0"]
        for k, triangle in enumerate(soup.tolist()):
            lines.append(f"grey polygon p{k} 0 0 9 " + " ".join(f"{c:.9g}" for corner in triangle for c in corner))
        scene.write_text("\n".join(lines) + "\n")
        tree = Path(folder) / "town.oct"
        tree.write_bytes(radiance.oconv(scene))
        rays = np.concatenate([origins, directions], 1).astype(np.float64).tobytes()
        forms = {"inform": "d", "outform": "d", "outspec": "L"}
        output = radiance.rtrace(rays, tree, header=False, **forms, nproc=threads, params=["-ab", "0"])
    return np.frombuffer(output, np.float64) < MISS


def angle_to_edges(soup: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> float:
    """Degrees: the smallest angle between a ray and a point on an edge."""
    a = soup.reshape(-1, 3).astype(np.float64) - origin
    b = np.roll(soup, -1, 1).reshape(-1, 3).astype(np.float64) - origin
    t = np.linspace(0.0, 1.0, 4097)[:, None, None]
    along = a + t * (b - a)
    cosine = (along @ direction) / np.maximum(np.linalg.norm(along, axis=-1), 1e-12)
    return float(np.degrees(np.arccos(np.clip(cosine.max(), -1.0, 1.0))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--boxes", type=int, default=40)
    parser.add_argument("--sensors", type=int, default=20_000)
    parser.add_argument("--days", default="2026-01-21:2026-12-21:30")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--json", type=Path, help="also write the rows to this file")
    options = parser.parse_args()
    soup = town(options.boxes)
    scene = at.Scene.from_arrays(soup, up="z")
    sensors = at.grid_sensors(scene, float(np.sqrt(at.face_sensors(scene).areas.sum() / options.sensors)))
    suns = at.suns_of(PLACE, at.times_of(parse_days(options.days), zone_of(PLACE), 60), "z")
    start = time.perf_counter()
    lights = at.DirectionalLights(-suns.directions)
    bits = at.visibility(scene, sensors.points, lights, sensors.normals, threads=options.threads).bits
    own_seconds = time.perf_counter() - start
    hidden = np.unpackbits(bits.view(np.uint8), axis=1, bitorder="little")[:, : len(suns.hours)].astype(bool)
    row, sun = np.nonzero(sensors.normals @ suns.directions.T > 1e-6)
    pairs = {"sensors": len(sensors), "suns": len(suns.hours), "pairs": len(row), "own_seconds": own_seconds}
    rows: list[dict] = []
    print(f"{len(sensors):,} sensors, {len(suns.hours)} suns: {len(row):,} pairs with the sun above the surface")
    if installed(library):
        receivers = Receivers.on_surface(sensors.points, sensors.normals, scene.origin, scene.middle)
        origins = receivers.origins[0].astype(np.float64) + scene.origin
        start = time.perf_counter()
        radiance_hit = hit_by_radiance(soup, origins[row], suns.directions[sun], options.threads)
        pairs["radiance_seconds"] = time.perf_counter() - start
        differ = np.flatnonzero(radiance_hit != hidden[row, sun])
        for k in differ:
            angle = angle_to_edges(soup, origins[row[k]], suns.directions[sun[k]])
            rows.append(
                {"sensor": int(row[k]), "sun": int(sun[k]), "radiance": bool(radiance_hit[k]), "degrees": angle}
            )
        print(f"Radiance {pairs['radiance_seconds']:.1f} s, Antumbra {own_seconds:.1f} s; {len(rows)} pairs differ")
        for r in rows:
            who = "Radiance" if r["radiance"] else "Antumbra"
            print(f"sensor {r['sensor']}, sun {r['sun']}: hidden for {who}; {r['degrees']:.1e} degrees from an edge")
    if options.json:
        options.json.write_text(json.dumps({"machine": machine(options.threads), **pairs, "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
