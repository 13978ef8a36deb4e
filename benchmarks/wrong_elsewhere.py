"""Counts wrong answers for rays and shadows, ours and those of peers, against exact arithmetic.

    python benchmarks/wrong_elsewhere.py [--rays N] [--seed N] [--json FILE] [--write PAGE]

All contenders get the same float32 triangles, origins and directions (from `zoo`), and return which rays are blocked.
The reference is real arithmetic on these numbers (`zoo_truth`), in which no ray leaves a closed mesh.

Points on surfaces have no such reference, because float32 rounds them off their faces. Their meshes are therefore
convex: outside, a point sees the sun exactly if the sun is in front of its face; inside, it never does. For peers, such
points are offset along the normal, by 1e-4, and in a second row by the offset of Mitsuba's `spawn_ray`, which grows
with the coordinates. Antumbra gets the original points with their normals.

--write inserts the table into a page, between two marks.
"""

import argparse
import json
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import numpy as np

import antumbra as at
from antumbra.base.errors import InputError
from common import has_embree, installed, machine
from comparison import start
from peers import embree, mitsuba_rays, open3d_rays, warp_rays
from peers.ray_contest import ray_set
from zoo import CASES, Case
from zoo_truth import above, blocked

BEGIN, END = "<!-- benchmarks/wrong_elsewhere.py writes this table -->\n", "<!-- end of the table -->\n"
RAY_EPSILON = 1500 * 2.0**-24  # of Mitsuba 3
OFFSETS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "offset 1e-4": lambda points: np.full(len(points), 1e-4),
    "offset of spawn_ray": lambda points: RAY_EPSILON * (1 + np.abs(points).max(1)),
}
"""Offsets of points on faces for peers: functions from points ((n, 3)) to lengths ((n,))."""

Peer = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def ours(case: Case) -> np.ndarray:
    """(n,) bool: Antumbra's answers."""
    faces = np.arange(3 * len(case.vertices)).reshape(-1, 3)
    scene = at.Scene.from_arrays(case.vertices.reshape(-1, 3).astype(np.float64), faces)
    corners = scene.triangles().vertices.astype(np.float64) + scene.origin
    assert np.array_equal(corners, case.vertices), f"{case.name}: the scene is not the input"
    if case.faces is None:
        return scene.occluded(case.origins.astype(np.float64), case.directions)
    hidden = np.zeros(len(case.origins), bool)
    for sun in np.unique(case.directions, axis=0):
        these = (case.directions == sun).all(1)
        light, points = at.DirectionalLight(-sun.astype(np.float64), angular_diameter=0.0), case.origins[these]
        lit = at.visibility(scene, points.astype(np.float64), light, normals=normals_of(case)[these], spp=1).seen
        hidden[these] = ~lit
    return hidden


def normals_of(case: Case) -> np.ndarray:
    """(n, 3) float64: the unit normals of the points' faces."""
    a, b, c = case.vertices[case.faces].astype(np.float64).transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


def truth(case: Case) -> np.ndarray:
    """(n,) bool: the correct answers."""
    if case.faces is None:
        hit = blocked(case.vertices, case.origins, case.directions)
        assert hit.all() or not case.inside, f"{case.name}: a ray leaves a closed mesh"
        return hit
    return case.inside | ~above(case.vertices[case.faces], case.directions)


def answers_of(peer: Peer, case: Case, offset: str) -> np.ndarray:
    """(n,) bool: a peer's answers; points on faces are offset as in OFFSETS."""
    if case.faces is None:
        return peer(case.vertices, case.origins, case.directions)
    normals, points = normals_of(case), case.origins.astype(np.float64)
    moved = (points + normals * OFFSETS[offset](points)[:, None]).astype(np.float32)
    behind = (normals * case.directions).sum(1) <= 0  # no renderer traces these, because the face itself blocks them
    return peer(case.vertices, moved, case.directions) | behind


def _embree(flags: int) -> Peer:
    def ask(vertices, origins, directions):
        with embree.Device() as device, embree.EmbreeScene(device, vertices, flags=flags) as scene:
            return embree.occluded(scene, origins, directions)

    return ask


def _trimesh(kind: str) -> Peer:
    def ask(vertices, origins, directions):
        import trimesh
        from trimesh.ray import ray_pyembree, ray_triangle

        mesh = trimesh.Trimesh(vertices.reshape(-1, 3), np.arange(3 * len(vertices)).reshape(-1, 3), process=False)
        module = {"embree": ray_pyembree, "numpy": ray_triangle}[kind]
        return module.RayMeshIntersector(mesh).intersects_any(origins, directions)

    return ask


def _open3d(vertices, origins, directions):
    scene = open3d_rays.Open3DScene(vertices)
    return np.array(scene.trace(scene.write(ray_set(origins, directions), np.arange(len(origins))), np.inf).numpy())


def _mitsuba(robust: bool) -> Peer:
    def ask(vertices, origins, directions):
        rays, ids = ray_set(origins, directions), np.arange(len(origins))
        scene = mitsuba_rays.MitsubaScene(vertices, robust)
        return mitsuba_rays.occluded_of(rays, ids, scene.trace(scene.write(rays, ids)))

    return ask


def _rtree():
    try:
        import rtree
    except ImportError as error:
        raise InputError(f"trimesh without Embree needs rtree ({error}): pip install rtree") from None
    return rtree


def peers() -> dict[str, Peer]:
    """The installed peers by name; prints which ones are skipped."""
    available: dict[str, Peer] = {}
    if has_embree():
        available |= {
            "Embree": _embree(0),
            "Embree, robust": _embree(embree.ROBUST),
            "trimesh, Embree": _trimesh("embree"),
        }
    if installed(_rtree):
        available["trimesh, numpy"] = _trimesh("numpy")
    if installed(open3d_rays.library):
        available["Open3D"] = _open3d
    if installed(mitsuba_rays.library):
        available |= {"Mitsuba": _mitsuba(False), "Mitsuba, robust": _mitsuba(True)}
    if installed(warp_rays.library):
        available["Warp"] = warp_rays.occluded
    return available


def count(n: int, seed: int) -> list[dict]:
    """A row per case and offset: its name, triangles, rays, blocked rays, and wrong answers of each contender."""
    rows, others = [], peers()
    for make in CASES:
        case = make(np.random.default_rng(seed), n)
        right = truth(case)
        about = {"triangles": len(case.vertices), "rays": len(right), "blocked": int(right.sum())}
        mistakes = {"Antumbra": int((ours(case) != right).sum())}
        for offset in OFFSETS if case.faces is not None else [""]:
            name = f"{case.name}, {offset}" if offset else case.name
            wrong = {each: int((answers_of(peer, case, offset) != right).sum()) for each, peer in others.items()}
            rows.append({"case": name, **about, "wrong": mistakes | wrong})
            print(f"{name}: {about}; wrong: {mistakes | wrong}", flush=True)
    return rows


def table(rows: list[dict]) -> str:
    """The rows as Markdown, with a column per contender and dots for 0."""
    names, most = list(rows[0]["wrong"]), max(row["rays"] for row in rows)
    lines = [f"| of {most:,} rays | {' | '.join(names)} |", f"|---|{'---:|' * len(names)}"]
    for row in rows:
        counts = " | ".join(f"{row['wrong'][name]:,}" if row["wrong"][name] else "·" for name in names)
        of = f" (of {row['rays']:,})" if row["rays"] < most else ""
        lines.append(f"| {row['case']}{of} | {counts} |")
    return "\n".join(lines) + "\n"


def versions() -> str:
    """The versions of the installed libraries."""
    texts = []
    for name in ("embreex", "trimesh", "open3d", "mitsuba", "warp-lang"):
        try:
            texts.append(f"{name} {version(name)}")
        except ModuleNotFoundError:
            continue
    return ", ".join(texts)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rays", type=int, default=10_000, help="of each case")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path, help="also write the rows to this file")
    parser.add_argument("--write", type=Path, metavar="PAGE", help="a page with the marks of the table")
    options = parser.parse_args()
    rows = count(options.rays, options.seed)
    about = {**machine(0), "versions": versions()}
    if options.json:
        options.json.write_text(json.dumps({"machine": about, "rows": rows}, indent=1))
    if options.write:
        head, _, after = options.write.read_text(encoding="utf-8").partition(BEGIN)
        tail = after.partition(END)[2]
        note = f"`python benchmarks/wrong_elsewhere.py --rays {options.rays}`, {about['processor']}; {versions()}."
        options.write.write_text(f"{head}{BEGIN}{table(rows)}\n{note}\n\n{END}{tail}", encoding="utf-8")


if __name__ == "__main__":
    start(main)
