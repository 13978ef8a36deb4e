"""Compares `intersection_matrix` with Ladybug's, which runs Radiance, on boxes in a town.

    python benchmarks/ladybug_matrix.py [--boxes N] [--sensors N] [--vectors N] [--rounds N] [--json FILE]

Both get the same Point3D, Vector3D and Face3D. Times are the CPU times of one process: for Ladybug, that includes its
files and Radiance's programs. Pairs on which the two differ are counted apart for vectors less than a degree above the
surface, which Radiance leaves out, and for all others, with the longest way of their rays through a box.
Requires: pip install pyradiance ladybug-radiance
"""

import argparse
import json
import os
import tempfile
from pathlib import Path

import numpy as np

import antumbra as at
from antumbra.integrations.ladybug import intersection_matrix
from common import installed, machine
from radiance_sun import town

GRAZING = np.sin(np.radians(1.0))  # cosine to the normal below which Radiance may leave out a vector


def library():
    """(``intersection_matrix`` of ladybug_radiance, module of ladybug's geometry). Raises InputError without them."""
    try:
        import pyradiance
        from ladybug_geometry import geometry3d
        from ladybug_radiance.config import folders
    except ImportError as error:
        raise at.InputError(f"Ladybug cannot be imported ({error}): pip install pyradiance ladybug-radiance") from None
    folders.radiance_path = str(Path(pyradiance.__file__).parent)
    from ladybug_radiance.intersection import intersection_matrix as of_ladybug

    return of_ladybug, geometry3d


def cpu_seconds(function, *arguments):
    """(CPU seconds of this process and its children, result)."""
    before = os.times()
    result = function(*arguments)
    return sum(os.times()[:4]) - sum(before[:4]), result


def chord(soup: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> float:
    """The distance between the first two triangles that a ray meets [Möller and Trumbore]; inf if there are fewer."""
    a, e1, e2 = soup[:, 0].astype(float), soup[:, 1].astype(float) - soup[:, 0], soup[:, 2].astype(float) - soup[:, 0]
    p = np.cross(direction, e2)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1.0 / (e1 * p).sum(1)
        u = ((origin - a) * p).sum(1) * scale
        q = np.cross(origin - a, e1)
        v, t = (q @ direction) * scale, (q * e2).sum(1) * scale
        met = np.sort(t[(u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0)])
    return float(met[1] - met[0]) if len(met) > 1 else np.inf


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--boxes", type=int, default=60)
    parser.add_argument("--sensors", type=int, default=5_000)
    parser.add_argument("--vectors", type=int, default=580)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", type=Path, help="also write the rows to this file")
    options = parser.parse_args()
    soup = town(options.boxes)
    scene = at.Scene.from_arrays(soup, up="z")
    sensors = at.grid_sensors(scene, float(np.sqrt(at.face_sensors(scene).areas.sum() / options.sensors)))
    points = sensors.points + 0.01 * sensors.normals  # Radiance's rays start on the surface itself
    rng = np.random.default_rng(2)
    vectors = rng.normal(size=(options.vectors, 3))
    vectors[:, 2] = np.abs(vectors[:, 2])
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    row = {"sensors": len(points), "vectors": len(vectors), "triangles": len(soup)}
    arguments = vectors, points, sensors.normals, [_Soup(soup)]
    peer = installed(library)
    if peer:
        of_ladybug, geometry = library()
        arguments = _of_geometry(geometry, *arguments[:3], soup)
    intersection_matrix(*arguments)  # loads kernels
    ours, theirs = list[float](), list[float]()
    for _ in range(options.rounds):
        seconds, seen = cpu_seconds(intersection_matrix, *arguments)
        ours.append(seconds)
        if peer:
            with tempfile.TemporaryDirectory() as folder:
                seconds, of_peer = cpu_seconds(of_ladybug, *arguments, 0, False, folder)
            theirs.append(seconds)
    row |= {"seconds": float(np.median(ours)), "seen": float(seen.mean())}
    print(f"{len(points):,} sensors, {len(vectors):,} vectors: Antumbra {row['seconds']:.2f} s of CPU time")
    if peer:
        cosines = sensors.normals @ vectors.T
        differ = seen != of_peer
        rest = np.argwhere(differ & (cosines > GRAZING))
        chords = [chord(soup, points[i], vectors[j]) for i, j in rest]
        row |= {"ladybug_seconds": float(np.median(theirs)), "ratio": float(np.median(theirs) / np.median(ours))}
        row |= {
            "differ_grazing": int(differ.sum()) - len(rest),
            "differ": len(rest),
            "chord": max(chords, default=0.0),
        }
        print(f"Ladybug {row['ladybug_seconds']:.2f} s, {row['ratio']:.1f} times as long")
        print(f"{row['differ_grazing']} pairs differ within a degree of the surface, which Radiance leaves out")
        print(f"{len(rest)} other pairs differ; their rays cross at most {1e3 * row['chord']:.2f} mm of a box")
    if options.json:
        options.json.write_text(json.dumps({"machine": machine(os.cpu_count() or 1), "rows": [row]}, indent=1))


class _Soup:
    """A mesh like Ladybug's, of triangles, where Ladybug is not installed."""

    def __init__(self, soup: np.ndarray):
        self.vertices, self.faces = soup.reshape(-1, 3), np.arange(3 * len(soup)).reshape(-1, 3)


def _of_geometry(geometry, vectors, points, normals, soup):
    """The arguments as objects of ladybug_geometry, with their rounding to float32 as in a scene."""
    faces = [geometry.Face3D([geometry.Point3D(*corner) for corner in triangle]) for triangle in soup.tolist()]
    lists = [geometry.Vector3D(*v) for v in vectors.tolist()], [geometry.Point3D(*p) for p in points.tolist()]
    return *lists, [geometry.Vector3D(*n) for n in normals.tolist()], faces


if __name__ == "__main__":
    main()
