"""Hours of sun beside Radiance, on a floor with boxes: every disagreement, and how near to an edge it is.

    python benchmarks/radiance_sun.py [--boxes N] [--sensors N] [--days DAYS] [--threads N] [--json FILE]

`rtrace` of Radiance traces each pair of sensor and sun whose sun is above the surface, from the same receivers in the
same directions: no surface, no shadow. It needs Radiance: pip install 'antumbra[all-peers]'. Its rays are float64, and
it reads the same vertices. A pair on which the two differ is listed with the angle by which the ray passes the nearest
edge of a box.
"""

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np

import antumbra as at
from antumbra.jobs.sun.sun_positions import parse_days, zone_of
from antumbra.query.receivers import Receivers
from common import installed, machine

PLACE = at.Place(52.0, 4.36, timezone="Europe/Amsterdam")
FAR = 1e4  # metres: where suns stand for Antumbra; the town is smaller than 100
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
    """(n, 3, 3) float32: a floor with boxes; no two of them share a plane."""
    rng = np.random.default_rng(7)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    faces = np.array([t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))])
    floor = [[[-40, -40, 0], [40, -40, 0], [40, 40, 0]], [[-40, -40, 0], [40, 40, 0], [-40, 40, 0]]]
    size, place = rng.uniform((3, 3, 4), (8, 8, 20), (boxes, 3)), rng.uniform(-30, 30, (boxes, 3)) * (1, 1, 0)
    made = [corners[faces] * s + p - (0, 0, 0.01) for s, p in zip(size, place)]
    return np.concatenate([np.array(floor, float), *made]).astype(np.float32)


def hit_by_radiance(soup: np.ndarray, origins: np.ndarray, directions: np.ndarray, threads: int) -> np.ndarray:
    """(n,) bool: the rays that meet a triangle, by rtrace."""
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
        found = radiance.rtrace(rays, tree, header=False, **forms, nproc=threads, params=["-ab", "0"])
    return np.frombuffer(found, np.float64) < MISS


def angle_to_edges(soup: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> float:
    """Degrees: the least angle between a ray and a point of an edge."""
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
    parser.add_argument("--json", type=Path, help="write the rows here too")
    given = parser.parse_args()
    soup = town(given.boxes)
    scene = at.Scene.from_arrays(soup, up="z")
    sensors = at.grid_sensors(scene, float(np.sqrt(at.face_sensors(scene).areas.sum() / given.sensors)))
    suns = at.suns_of(PLACE, at.times_of(parse_days(given.days), zone_of(PLACE), 60), "z")
    start = time.perf_counter()
    lights = at.DirectionalLights(-suns.directions)
    bits = at.visibility(scene, sensors.points, lights, sensors.normals, threads=given.threads).bits
    own_seconds = time.perf_counter() - start
    hidden = np.unpackbits(bits.view(np.uint8), axis=1, bitorder="little")[:, : len(suns.hours)].astype(bool)
    row, sun = np.nonzero(sensors.normals @ suns.directions.T > 1e-6)
    pairs = {"sensors": len(sensors), "suns": len(suns.hours), "pairs": len(row), "own_seconds": own_seconds}
    rows: list[dict] = []
    print(f"{len(sensors):,} sensors, {len(suns.hours)} suns: {len(row):,} pairs with the sun above the surface")
    if installed(library):
        receivers = Receivers.on_surface(sensors.points, sensors.normals, scene.origin)
        origins = receivers.origins[0].astype(np.float64) + scene.origin
        start = time.perf_counter()
        met = hit_by_radiance(soup, origins[row], suns.directions[sun], given.threads)
        pairs["radiance_seconds"] = time.perf_counter() - start
        differ = np.flatnonzero(met != hidden[row, sun])
        for k in differ:
            angle = angle_to_edges(soup, origins[row[k]], suns.directions[sun[k]])
            rows.append({"sensor": int(row[k]), "sun": int(sun[k]), "radiance": bool(met[k]), "degrees": angle})
        print(f"Radiance {pairs['radiance_seconds']:.1f} s, Antumbra {own_seconds:.1f} s; {len(rows)} pairs differ")
        for r in rows:
            who = "Radiance" if r["radiance"] else "Antumbra"
            print(f"sensor {r['sensor']}, sun {r['sun']}: hidden for {who}; {r['degrees']:.1e} degrees from an edge")
    if given.json:
        given.json.write_text(json.dumps({"machine": machine(given.threads), **pairs, "rows": rows}, indent=1))


if __name__ == "__main__":
    main()
