"""Drop-in faces beside the libraries whose calls they have: times, and wrong answers.

    python benchmarks/drop_in.py [SCENE ...] [--rays N] [--small N] [--rounds N] [--json FILE]

The contenders are called as users call them, on all cores that they use: ``at.trimesh_ray(mesh)`` and trimesh's own
``mesh.ray`` with embreex, and both RaycastingScenes. Rays start anywhere in the bounds of a scene, with random
directions; points lie in the bounds. The default scenes are the Stanford bunny, Sponza and Delft from $ANTUMBRA_SCENES,
or from ../shared/scenes beside the repository, else generated ones.

Wrong answers are counted on balls in coordinates that float32 holds, against integer arithmetic (`zoo_truth`): hits of
rays through vertices and edges, of rays through thin layers, and points next to a surface. Each case comes at the
origin, and a million units away.
"""

import json
import sys
from collections.abc import Callable, Iterator
from statistics import median
from time import perf_counter
from typing import NamedTuple

import numpy as np
import trimesh

import antumbra as at
from antumbra.integrations.open3d import RaycastingScene
from antumbra.kernels.parallel import thread_count
from common import SCENES, arguments, installed, machine
from comparison import start
from peers import open3d_rays
from wrong_elsewhere import versions
from zoo_truth import crossings, in_a_plane

REAL = "stanford_bunny", "sponza_crytek", "delft_city"
GENERATED = {"atrium": 100_000, "city": 100_000}  # names of procedural scenes, and their triangles
TRIMESH, OPEN3D = "trimesh, Embree", "Open3D"

# --- Contenders -------------------------------------------------------------------------------------------------------


class Rays(NamedTuple):
    """Rays and points."""

    origins: np.ndarray  # (n, 3) float64; also the points
    directions: np.ndarray  # (n, 3) float32

    def rows(self) -> np.ndarray:
        """(n, 6) float32, for RaycastingScenes."""
        return np.concatenate([self.origins, self.directions], axis=1).astype(np.float32)


Contender = dict[str, Callable[[Rays], np.ndarray]]
"""Query -> function. "all hits" are returned as (n,) counts."""


def trimesh_calls(ray) -> Contender:
    """The queries of an intersector."""

    def count(rays: Rays) -> np.ndarray:
        return np.bincount(ray.intersects_location(*rays)[1], minlength=len(rays.origins))

    return {
        "any hit": lambda rays: ray.intersects_any(*rays),
        "first hit": lambda rays: ray.intersects_first(*rays),
        "all hits": lambda rays: ray.intersects_id(*rays)[0],
        "all locations": count,
        "contains": lambda rays: ray.contains_points(rays.origins),
    }


def open3d_calls(scene, tensor: Callable) -> Contender:
    """The queries of a RaycastingScene. `tensor` converts arrays, and is timed, since users do so too."""

    def array(result) -> np.ndarray:
        return result if isinstance(result, np.ndarray) else result.numpy()

    def points(rays: Rays):
        return tensor(rays.origins.astype(np.float32))

    return {
        "any hit": lambda rays: array(scene.test_occlusions(tensor(rays.rows()))),
        "first hit": lambda rays: array(scene.cast_rays(tensor(rays.rows()))["t_hit"]),
        "all hits": lambda rays: np.diff(array(scene.list_intersections(tensor(rays.rows()))["ray_splits"])),
        "hit counts": lambda rays: array(scene.count_intersections(tensor(rays.rows()))),
        "contains": lambda rays: array(scene.compute_occupancy(points(rays))) > 0.5,
        "distance": lambda rays: array(scene.compute_distance(points(rays))),
        "signed distance": lambda rays: array(scene.compute_signed_distance(points(rays))),
        "closest points": lambda rays: array(scene.compute_closest_points(points(rays))["points"]),
    }


def _embreex():
    try:
        from trimesh.ray.ray_pyembree import RayMeshIntersector
    except ImportError as error:
        raise at.InputError(f"trimesh with Embree ({error}): pip install embreex") from None
    return RayMeshIntersector


def _rtree():
    try:
        import rtree  # noqa: F401
        from trimesh.ray.ray_triangle import RayMeshIntersector
    except ImportError as error:
        raise at.InputError(f"trimesh without Embree ({error}): pip install rtree") from None
    return RayMeshIntersector


def pairs(mesh: trimesh.Trimesh) -> Iterator[tuple[str, Contender, Contender | None]]:
    """(peer, ours, theirs) for each face; `theirs` is None if the peer is not installed."""
    theirs = trimesh_calls(_embreex()(mesh)) if installed(_embreex) else None
    yield TRIMESH, trimesh_calls(at.trimesh_ray(mesh)), theirs
    yield OPEN3D, open3d_calls(_filled(RaycastingScene(), mesh, np.asarray), np.asarray), _open3d(mesh)


def _open3d(mesh: trimesh.Trimesh) -> Contender | None:
    if not installed(open3d_rays.library):
        return None
    o3d = open3d_rays.library()
    return open3d_calls(_filled(o3d.t.geometry.RaycastingScene(), mesh, o3d.core.Tensor), o3d.core.Tensor)


def _filled(scene, mesh: trimesh.Trimesh, tensor: Callable):
    vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32)
    scene.add_triangles(tensor(vertices), tensor(faces))
    return scene


# --- Times ------------------------------------------------------------------------------------------------------------


def meshes(paths: list) -> Iterator[tuple[str, trimesh.Trimesh]]:
    """Name and mesh of each scene."""
    paths = paths or [path for name in REAL if (path := SCENES / name / "scene.glb").exists()]
    scenes = [(path.parent.name, at.load(path)) for path in paths]
    if not scenes:
        print(f"no scene given and none in {SCENES}: using generated ones")
        yield "ball", trimesh.creation.icosphere(6)
        scenes = [(name, at.procedural(name, triangles=n)) for name, n in GENERATED.items()]
    for name, scene in scenes:
        soup = scene.triangles().vertices.reshape(-1, 3) + scene.origin
        yield name, trimesh.Trimesh(soup, np.arange(len(soup)).reshape(-1, 3))


def time_queries(name: str, mesh: trimesh.Trimesh, n: int, rounds: int) -> list[dict]:
    """A row per peer and query, with medians over rounds in which both contenders alternate."""
    rng = np.random.default_rng(1)
    rays = Rays(rng.uniform(*mesh.bounds, (n, 3)), rng.normal(size=(n, 3)).astype(np.float32))
    few, rows = Rays(*(each[:1000] for each in rays)), []
    for peer, ours, theirs in pairs(mesh):
        for query, call in ours.items():
            calls = [call] if theirs is None else [call, theirs[query]]
            for each in calls:
                each(few)  # builds trees and compiles kernels
            times = [[_seconds(each, rays) for each in calls] for _ in range(rounds)]
            seconds = [median(column) for column in zip(*times)]
            row = {"scene": name, "triangles": len(mesh.faces), "query": query, "peer": peer, "queries": n}
            row |= {"ours": seconds[0], "theirs": seconds[1] if theirs else None}
            row["ratio"] = seconds[1] / seconds[0] if theirs else None
            rows.append(row)
            print(_line(row), flush=True)
    return rows


def _seconds(call: Callable, rays: Rays) -> float:
    begin = perf_counter()
    call(rays)
    return perf_counter() - begin


def _line(row: dict) -> str:
    text = f"{row['scene']:16} {row['query']:14} {row['peer']:16} {row['ours']:8.3f} s"
    return text if row["ratio"] is None else f"{text} {row['theirs']:8.3f} s {row['ratio']:7.2f} x"


# --- Wrong answers ----------------------------------------------------------------------------------------------------


class Case(NamedTuple):
    """A query with a known answer, in numbers that float32 holds."""

    name: str
    mesh: trimesh.Trimesh
    query: str
    rays: Rays
    truth: np.ndarray  # (n,) int64 counts, or bool


SIZES = {"": (1.0, 2.0**-20, 0.0), ", 1e6 away": (64.0, 2.0**-4, 1e6)}
"""Suffix of a case -> radius of a ball, step of all coordinates, and distance from the origin along each axis."""


def cases(n: int, seed: int) -> Iterator[Case]:
    """All cases, with about n rays or points each."""
    for suffix, (radius, step, away) in SIZES.items():
        rng = np.random.default_rng(seed)
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        turn *= np.linalg.det(turn)

        def in_steps(points, step=step, away=away) -> np.ndarray:
            return np.round(points / step) * step + away

        sphere = trimesh.creation.icosphere(2)
        places = in_steps(radius * sphere.vertices @ turn.T, 2 * step)  # so that middles of edges are in steps
        ball = trimesh.Trimesh(places, sphere.faces, process=False)
        corners = np.asarray(ball.triangles, np.float32)

        def hits(name, mesh, origins, directions, suffix=suffix) -> Case:
            rays = Rays(origins, np.asarray(directions, np.float32))
            truth = crossings(np.asarray(mesh.triangles, np.float32), origins.astype(np.float32), rays.directions)
            return Case(name + suffix, mesh, "all hits", rays, truth)

        origins = in_steps(radius * rng.uniform(-1.5, 1.5, (n, 3)))
        which = ball.faces[rng.integers(len(ball.faces), size=n)]
        ends = ball.vertices[which[:, 0]]
        yield hits("rays through vertices", ball, origins, ends - origins)
        middles = (ends + ball.vertices[which[:, 1]]) / 2
        yield hits("rays through edges", ball, origins, middles - origins)

        layers = trimesh.util.concatenate(
            [trimesh.Trimesh(ball.vertices + [0, 0, k * step], ball.faces, process=False) for k in range(4)]
        )
        yield hits("rays through thin layers", layers, origins, rng.normal(size=(n, 3)))

        places = (rng.dirichlet((1, 1, 1), 2 * n)[:, :, None] * corners[rng.integers(len(corners), size=2 * n)]).sum(1)
        points = in_steps(places - away)
        points = points[~in_a_plane(corners, points.astype(np.float32))][:n]
        rays = Rays(points, rng.normal(size=points.shape).astype(np.float32))
        inside = crossings(corners, points.astype(np.float32), rays.directions) % 2 == 1
        yield Case("points next to a surface" + suffix, ball, "contains", rays, inside)


def contenders(mesh: trimesh.Trimesh) -> dict[str, Contender]:
    """Name -> queries of ours and of the installed peers. Counts of hits are those of distinct locations."""
    found = {}
    for peer, ours, theirs in pairs(mesh):
        found[f"Antumbra as {peer.partition(',')[0]}"] = ours
        if theirs is not None:
            found[peer] = theirs
    if installed(_rtree):
        found["trimesh, numpy"] = trimesh_calls(_rtree()(mesh))
    return {name: {**calls, "all hits": calls.get("all locations", calls["all hits"])} for name, calls in found.items()}


def count_wrong(n: int, seed: int = 1) -> list[dict]:
    """A row per case and contender: the number of its wrong answers."""
    rows = []
    for case in cases(n, seed):
        for name, calls in contenders(case.mesh).items():
            wrong = int((calls[case.query](case.rays) != case.truth).sum())
            rows.append({"case": case.name, "contender": name, "queries": len(case.truth), "wrong": wrong})
            print(f"{case.name:36} {name:24} {wrong:8,} of {len(case.truth):,} wrong", flush=True)
    return rows


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--rays", type=int, default=1_000_000, help="rays and points of each timed query")
    parser.add_argument("--small", type=int, default=1_000, help="rays and points of each case of wrong answers")
    parser.set_defaults(rounds=5)
    options = parser.parse_args()
    wrong = count_wrong(options.small)
    rows = [row for each in meshes(options.scene) for row in time_queries(*each, options.rays, options.rounds)]
    if options.json is not None:
        about = {**machine(thread_count(None)), "versions": versions()}
        options.json.write_text(json.dumps({"machine": about, "rows": rows, "wrong": wrong}, indent=1) + "\n")


if __name__ == "__main__":
    sys.exit(start(main))
