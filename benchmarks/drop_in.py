"""Drop-in faces beside the libraries whose calls they have: times, and wrong answers.

    python benchmarks/drop_in.py [SCENE ...] [--rays N ...] [--small N] [--rounds N] [--json FILE]

The contenders are called as users call them, on all cores that they use: ``at.trimesh_ray(mesh)`` and trimesh's own
``mesh.ray`` with embreex, and both RaycastingScenes. Rays start anywhere in the bounds of a scene, with random
directions; points lie in the bounds. The default scenes are a closed ball, and the Stanford bunny, Sponza and Delft,
which have open edges, from $ANTUMBRA_SCENES, or from ../shared/scenes beside the repository, else generated ones. Each
query is timed with 1, 100, 10,000 and 1,000,000 rays or points a call; "first call" is a new intersector's, with its
set-up and 1,000 any-hit rays.

Wrong answers are counted on balls in coordinates that float32 holds, against integer arithmetic (`zoo_truth`): hits of
rays through vertices and edges, of rays through thin layers, and points next to a surface. Each case comes at the
origin, and a million units away.
"""

import json
import sys
from collections.abc import Callable, Iterator
from functools import partial
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
COUNTS = 1, 100, 10_000, 1_000_000

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


Maker = Callable[[trimesh.Trimesh], Contender]


def makers() -> Iterator[tuple[str, Maker, Maker | None]]:
    """(peer, ours, theirs) for each face; `theirs` is None if the peer is not installed."""
    theirs = _embreex() if installed(_embreex) else None
    peer = theirs and (lambda mesh: trimesh_calls(theirs(mesh)))
    yield TRIMESH, lambda mesh: trimesh_calls(at.trimesh_ray(mesh)), peer
    yield OPEN3D, lambda mesh: open3d_calls(_filled(RaycastingScene(), mesh, np.asarray), np.asarray), _open3d()


def pairs(mesh: trimesh.Trimesh) -> Iterator[tuple[str, Contender, Contender | None]]:
    """`makers`, with the contenders for a mesh."""
    for peer, ours, theirs in makers():
        yield peer, ours(mesh), theirs and theirs(mesh)


def _open3d() -> Maker | None:
    if not installed(open3d_rays.library):
        return None
    o3d = open3d_rays.library()
    tensor = o3d.core.Tensor
    return lambda mesh: open3d_calls(_filled(o3d.t.geometry.RaycastingScene(), mesh, tensor), tensor)


def _filled(scene, mesh: trimesh.Trimesh, tensor: Callable):
    vertices, faces = np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32)
    scene.add_triangles(tensor(vertices), tensor(faces))
    return scene


# --- Times ------------------------------------------------------------------------------------------------------------


def meshes(paths: list) -> Iterator[tuple[str, trimesh.Trimesh]]:
    """Name and mesh of each scene."""
    if not paths:
        yield "ball", trimesh.creation.icosphere(6)  # closed, unlike the others
    paths = paths or [path for name in REAL if (path := SCENES / name / "scene.glb").exists()]
    scenes = [(path.parent.name, at.load(path)) for path in paths]
    if not scenes:
        print(f"no scene given and none in {SCENES}: using generated ones")
        scenes = [(name, at.procedural(name, triangles=n)) for name, n in GENERATED.items()]
    for name, scene in scenes:
        soup = scene.triangles().vertices.reshape(-1, 3) + scene.origin
        yield name, trimesh.Trimesh(soup, np.arange(len(soup)).reshape(-1, 3))


def time_queries(name: str, mesh: trimesh.Trimesh, counts: list[int], rounds: int) -> list[dict]:
    """A row per peer, query and number of rays, with medians over rounds in which both contenders alternate."""
    rng = np.random.default_rng(1)
    n = max(counts)
    rays = Rays(rng.uniform(*mesh.bounds, (n, 3)), rng.normal(size=(n, 3)).astype(np.float32))
    rows = []

    def add(peer: str, query: str, count: int, calls: list[Callable[[], object]], repeats: int) -> None:
        times = [[_seconds(each, repeats) for each in calls] for _ in range(rounds)]
        seconds = [median(column) for column in zip(*times)]
        row = {"scene": name, "triangles": len(mesh.faces), "query": query, "peer": peer, "queries": count}
        row |= {"ours": seconds[0], "theirs": seconds[1] if len(seconds) > 1 else None}
        row["ratio"] = None if row["theirs"] is None else seconds[1] / seconds[0]
        rows.append(row)
        print(_line(row), flush=True)

    some = _first(rays, 1000)
    for peer, ours, theirs in pairs(mesh):
        for query, call in ours.items():
            calls = [call] if theirs is None else [call, theirs[query]]
            for each in calls:
                each(some)  # builds trees and compiles kernels
            for count in counts:
                part = _first(rays, count)
                add(peer, query, count, [partial(each, part) for each in calls], max(1, _REPEATED // count))
    for peer, *both in makers():
        starts = [partial(_start, make, mesh, some) for make in both if make is not None]
        add(peer, "first call", 1000, starts, 1)
    return rows


_REPEATED = 1000  # rays of the calls whose mean is one time


def _first(rays: Rays, n: int) -> Rays:
    return Rays(*(each[:n] for each in rays))


def _start(make: Maker, mesh: trimesh.Trimesh, rays: Rays) -> None:
    make(mesh.copy())["any hit"](rays)


def _seconds(call: Callable[[], object], repeats: int) -> float:
    """The mean time of a call."""
    begin = perf_counter()
    for _ in range(repeats):
        call()
    return (perf_counter() - begin) / repeats


def _line(row: dict) -> str:
    text = f"{row['scene']:16} {row['query']:14} {row['peer']:16} {row['queries']:9,} {1e3 * row['ours']:10.3f} ms"
    return text if row["ratio"] is None else f"{text} {1e3 * row['theirs']:10.3f} ms {row['ratio']:7.2f} x"


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
    parser.add_argument("--rays", type=int, nargs="+", default=COUNTS, help="rays and points of each timed query")
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
