"""Instances versus flattened copies: a forest too large to flatten, and rays through one that fits both ways.

    python benchmarks/instances.py [--trees N] [--triangles N] [--size W H] [--fits N] [--rays N] [--json FILE]

The large forest is rendered once, in a process of its own, with the default picture's sun and sky. Its memory is the
peak of that process. Rays through the smaller forest alternate between both forms of the scene in each round, and
`ratio` is the time of instances over that of flattened copies. All answers are compared, bit by bit.
"""

import json
import multiprocessing
from collections.abc import Callable
from statistics import median
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

import antumbra as at
from antumbra.cli import console as report
from antumbra.generate import palette
from antumbra.generate.props import bare_tree, conifer, tree
from antumbra.store.system_resources import peak_resident_memory
from common import arguments, machine

SPACING = 4.6
"""Metres between trees."""

KINDS = 6
"""Meshes of trees."""


class Ratio(NamedTuple):
    """Seconds of one kind of query, medians over rounds."""

    query: str
    rays: int
    instances: float
    flattened: float
    ratio: float


class Picture(NamedTuple):
    """The picture of a forest."""

    trees: int
    triangles: int
    load: float  # seconds to make the scene
    first: float  # seconds of the first picture, with its trees
    second: float  # seconds of the same picture again
    rays: int  # shadow rays
    peak: int | None  # bytes


def grown(kind: int, triangles: int) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """(vertices and faces of a tree of about this many triangles, its colours)."""
    rng = np.random.default_rng([kind, 7])
    if kind % 3 == 2:
        mesh = conifer(rng, 11.0, max(triangles // 4 - 10, 12), 1.0)
    else:
        bare = bare_tree(rng, 9.0, min(1.0, (triangles / 5000) ** 0.5))
        leaves = max((triangles - len(bare.wood.faces)) // 4, 12)
        mesh = tree(rng, bare, leaves, float(np.clip(10.0 / leaves**0.5, 0.1, 1.2)))
    return (mesh.vertices, mesh.faces), np.asarray(palette.PALETTE, np.float32)[mesh.colour]


def forest(trees: int, triangles: int, instances: bool | None = None) -> at.Scene:
    """About `trees` trees of about `triangles` triangles each, turned and scaled, on a level ground."""
    side = max(round(trees**0.5), 1)
    rng, half = np.random.default_rng(3), side * SPACING / 2.0
    x, z = (np.mgrid[:side, :side] * SPACING - half + rng.uniform(-1.5, 1.5, (2, side, side))).reshape(2, -1)
    angle, size = rng.uniform(0.0, 2.0 * np.pi, x.size), rng.uniform(0.75, 1.25, x.size)
    matrices = np.zeros((x.size, 3, 4))
    matrices[:, 0, 0] = matrices[:, 2, 2] = size * np.cos(angle)
    matrices[:, 0, 2] = size * np.sin(angle)
    matrices[:, 2, 0], matrices[:, 1, 1] = -matrices[:, 0, 2], size
    matrices[:, 0, 3], matrices[:, 2, 3] = x, z
    kinds = rng.integers(0, KINDS, x.size)
    corners = np.array([[-half, 0, -half], [half, 0, -half], [half, 0, half], [-half, 0, half]]) * 1.05
    ground = corners, np.array([[0, 2, 1], [0, 3, 2]])
    meshes = [grown(kind, triangles) for kind in range(KINDS)]
    return at.Scene.from_instances(
        [ground, *(mesh for mesh, _ in meshes)],
        [np.eye(4)[None], *(matrices[kinds == kind] for kind in range(KINDS))],
        [np.array([0.2, 0.16, 0.1]), *(colour for _, colour in meshes)],
        name="forest",
        instances=instances,
    )


def camera(scene: at.Scene, width: int, height: int) -> at.Camera:
    """A view from above the crowns to the horizon."""
    half = float(np.ptp(scene.bounds[:, 0])) / 2.0
    ahead = max(0.9 * half - 60.0, 0.0)
    return at.Camera((0, 22, 0.9 * half + 10.0), (0, 2, ahead), vfov=55.0, width=width, height=height)


def picture(trees: int, triangles: int, size: tuple[int, int], threads: int | None) -> Picture:
    """Make and render a forest of instances."""
    start = perf_counter()
    scene = forest(trees, triangles, True)
    load, seconds = perf_counter() - start, []
    view, lights = camera(scene, *size), scene.default_lights()
    for _ in range(2):
        start = perf_counter()
        frame = at.render(scene, view, lights, threads=threads)
        seconds.append(perf_counter() - start)
    return Picture(
        len(scene.objects) - 1, scene.n_triangles, load, seconds[0], seconds[1], frame.rays, peak_resident_memory()
    )


def _apart(*arguments: Any) -> Picture:
    """`picture` in a new process, whose peak of memory is that of the picture."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(picture, arguments)


def queries(scene: at.Scene, n: int) -> dict[str, Callable[[at.Scene], tuple[np.ndarray, ...]]]:
    """Kinds of queries of n rays: functions of a scene that return arrays to compare."""
    rng, (low, high) = np.random.default_rng(5), scene.bounds
    side = max(round(n**0.5), 2)
    down = np.stack(np.meshgrid(*np.linspace(low[[0, 2]], high[[0, 2]], side).T), -1).reshape(-1, 2)
    above = np.stack([down[:, 0], np.full(len(down), 40.0), down[:, 1]], 1)
    inside = rng.uniform(low, high, (n, 3))
    ends, directions = inside + rng.normal(size=(n, 3)) * 8.0, rng.normal(size=(n, 3))
    view = camera(scene, side, side)
    return {
        "closest, camera": lambda s: (s.engine.surfaces(view).depth,),
        "closest, from above": lambda s: tuple(s.closest_hit(above, (0.1, -1.0, 0.05))),
        "closest, random": lambda s: tuple(s.closest_hit(inside, directions)),
        "occluded, random segments": lambda s: (s.occluded(inside, targets=ends),),
        "occluded, to the sun": lambda s: (s.occluded(above - (0, 35, 0), (0.3, 1.0, 0.2)),),
    }


def compared(scene: at.Scene, flat: at.Scene, n: int, rounds: int) -> list[Ratio]:
    """Time all kinds of queries in both forms of a scene, in turns.

    Raises
    ------
    RuntimeError
        If an answer differs, which is a bug.
    """
    rows = []
    for name, ask in queries(scene, n).items():
        answers = [ask(each) for each in (scene, flat)]  # also builds trees
        if not all(np.array_equal(a, b) for a, b in zip(*answers, strict=True)):
            raise RuntimeError(f"{name}: instances differ from flattened copies; please report this")
        seconds: tuple[list[float], list[float]] = [], []
        for _ in range(rounds):
            for each, times in zip((scene, flat), seconds):
                start = perf_counter()
                ask(each)
                times.append(perf_counter() - start)
        one, other = map(median, seconds)
        rows.append(Ratio(name, answers[0][0].size, one, other, one / other))
    return rows


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("--trees", type=int, default=100_000, help="trees of the large forest; 0: leave it out")
    parser.add_argument("--triangles", type=int, default=20_000, help="triangles of a tree")
    parser.add_argument("--size", type=int, nargs=2, default=(1920, 1080), metavar=("W", "H"))
    parser.add_argument("--fits", type=int, default=500, help="trees of the forest that is also flattened")
    parser.add_argument("--rays", type=int, default=400_000)
    args = parser.parse_args()
    large = _apart(args.trees, args.triangles, tuple(args.size), args.threads) if args.trees else None
    if large is not None:
        report.print_fields(
            [
                (name, f"{value:,}" if isinstance(value, int) else f"{value:.2f}")
                for name, value in large._asdict().items()
            ]
        )
    scene, flat = (forest(args.fits, args.triangles, choice) for choice in (True, False))
    rows = compared(scene, flat, args.rays, args.rounds)
    for row in rows:
        print(
            f"{row.query:28} {row.rays:>10,} rays {row.instances:8.3f} s {row.flattened:8.3f} s  ratio {row.ratio:.2f}"
        )
    if args.json:
        threads = args.threads or 0
        result = {
            "machine": machine(threads),
            "large": large and large._asdict(),
            "rows": [row._asdict() for row in rows],
        }
        args.json.write_text(json.dumps(result, indent=1) + "\n")


if __name__ == "__main__":
    main()
