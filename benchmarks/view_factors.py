"""Compares `view_factors` with pyViewFactor and raystrack: errors in closed form, row sums, and time.

    python benchmarks/view_factors.py [--divisions N] [--samples N] [--rounds N] [--json FILE]

- "rectangles": two equal squares, opposite each other at the distance of a side
- "edge": two squares at a right angle with a common edge
- "room": the inside of a cube, each side in N x N pairs of triangles. The factors between whole sides are known.
- "obstructed room": with a smaller box in it, of which each row of the room has a share: A_i F_ij of all rows to the
  box add up to the area of the box

Each triangle of a room is a surface. The error of a room is that of the factors between sides, and its row-sum error is
the largest deviation of a row's sum from 1. Times are CPU times of all threads, the median of the rounds, without
compilation. pyViewFactor integrates each pair of faces, and decides by one ray between their centres whether they see
each other. raystrack counts quasi-random rays, as many as Antumbra. Requires: pip install pyviewfactor, and
pip install --no-deps raystrack, as it asks for an older Numba.
"""

import argparse
import json
import os
import time
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np

import antumbra as at
from common import installed, machine


class Case(NamedTuple):
    """Triangles in surfaces, with what is known of their view factors."""

    name: str
    soup: np.ndarray  # (n, 3, 3)
    surface: np.ndarray  # (n,) int: the surface of each triangle
    side: np.ndarray  # (surfaces,) int: surfaces with one number form a side
    exact: dict[tuple[int, int], float]  # (from side, to side) -> view factor
    closed: bool


# --- Cases ------------------------------------------------------------------------------------------------------------


def rectangle(corner, u, v, divisions: int = 1) -> np.ndarray:
    """(2 n^2, 3, 3) float64: triangles whose front is the side of u x v."""
    a, u, v = (np.array(each, float) for each in (corner, u, v))
    i, j = (each.ravel()[:, None] / divisions for each in np.meshgrid(np.arange(divisions), np.arange(divisions)))
    at_corners = [a + (i + p / divisions) * u + (j + q / divisions) * v for p, q in ((0, 0), (1, 0), (1, 1), (0, 1))]
    return np.concatenate([np.stack([at_corners[k] for k in three], 1) for three in ((0, 1, 2), (0, 2, 3))])


def box(size: float, corner, divisions: int, inside: bool) -> list[np.ndarray]:
    """The six sides of a cube."""
    o, (x, y, z) = np.array(corner, float), size * np.eye(3)
    sides = [(o, x, y), (o, y, z), (o, z, x), (o + z, y, x), (o + x, z, y), (o + y, x, z)]
    return [rectangle(a, *((u, v) if inside else (v, u)), divisions) for a, u, v in sides]


OPPOSITE, ADJACENT = 0.19982489569838746, 0.20004377607540316  # of a cube's sides [Howell, C-11 and C-14]


def cases(divisions: int) -> list[Case]:
    """The cases, whose exact factors are those of a cube."""
    floor, _, front, ceiling = box(1.0, (0, 0, 0), 1, True)[:4]
    found = [
        _case("rectangles", [floor, ceiling], {(0, 1): OPPOSITE, (1, 0): OPPOSITE}, by_side=True, closed=False),
        _case("edge", [floor, front], {(0, 1): ADJACENT, (1, 0): ADJACENT}, by_side=True, closed=False),
    ]
    room = box(1.0, (0, 0, 0), divisions, True)
    exact = {(i, j): OPPOSITE if (i - j) % 3 == 0 else ADJACENT for i in range(6) for j in range(6) if i != j}
    found.append(_case("room", room, exact, by_side=False, closed=True))
    obstacle = np.concatenate(box(0.4, (0.3, 0.25, 0.2), 1, False))
    sides = [np.concatenate(room), obstacle]
    return [*found, _case("obstructed room", sides, {(0, 1): 0.16, (1, 0): 1.0}, by_side=False, closed=True)]


def _case(name: str, sides: list[np.ndarray], exact: dict, by_side: bool, closed: bool) -> Case:
    side = np.repeat(np.arange(len(sides)), [len(each) for each in sides])
    surface = side if by_side else np.arange(len(side))
    return Case(name, np.concatenate(sides), surface, np.arange(len(sides)) if by_side else side, exact, closed)


# --- Contenders: functions of (case, samples) -> a function that returns (surfaces, surfaces) factors -----------------


def antumbra(case: Case, samples: int):
    scene = at.Scene.from_arrays(case.soup, up="z")
    return lambda: at.view_factors(scene, case.surface, samples=samples, progress=False).factors.toarray()


def pyviewfactor_library():
    try:
        import pyviewfactor
    except ImportError:
        raise at.InputError("pyViewFactor is not installed: pip install pyviewfactor") from None
    return pyviewfactor


def pyviewfactor(case: Case, samples: int):
    import pyvista

    numbers = np.insert(np.arange(3 * len(case.soup)).reshape(-1, 3), 0, 3, axis=1)
    flipped = case.soup[:, ::-1]  # its faces look against the normal of counterclockwise corners
    meshes = [pyvista.PolyData(soup.reshape(-1, 3), numbers.ravel()) for soup in (case.soup, flipped)]
    compute = pyviewfactor_library().compute_viewfactor_matrix
    areas = _areas(case.soup)
    mesh = max(meshes, key=lambda each: np.nansum(compute(each)))

    def run():
        of_faces = compute(mesh).T  # F[i, j] is the factor from j to i
        n = len(case.side)
        sums = np.zeros((n, n))
        np.add.at(sums, (case.surface[:, None], case.surface[None]), areas[:, None] * of_faces)
        return sums / np.bincount(case.surface, areas)[:, None]

    return run


def raystrack_library():
    try:
        import raystrack
    except ImportError:
        raise at.InputError("raystrack is not installed: pip install --no-deps raystrack") from None
    return raystrack


def raystrack(case: Case, samples: int):
    rt = raystrack_library()
    meshes = {}
    for k in range(len(case.side)):
        soup = case.soup[case.surface == k].astype(np.float32)
        meshes[str(k)] = rt.Mesh(soup.reshape(-1, 3), np.arange(3 * len(soup), dtype=np.int32).reshape(-1, 3))
    scene, n = rt.Scene.from_meshes(meshes), len(meshes)
    per_cell, cells = max(1, samples // 64), 8
    options = rt.SolveOptions(
        sampling=rt.Sampling(density=cells, rays_per_cell=per_cell, seed=1),
        accuracy=rt.Accuracy(max_replicates=8, min_replicates=8, tolerance=0.0),
    )

    def run():
        with rt.Solver(scene, device="cpu", bvh="builtin") as solver:
            result = solver.solve(rt.Query.matrix(), options, rt.Budget(rays=samples * n))
        place = {channel: k for k, channel in enumerate(result.channels)}
        columns = [place[rt.Channel("surface", str(k), "front")] for k in range(n)]
        return result.dense()[:, columns]

    return run


def _areas(soup: np.ndarray) -> np.ndarray:
    return np.linalg.norm(np.cross(soup[:, 1] - soup[:, 0], soup[:, 2] - soup[:, 0]), axis=1) / 2.0


CONTENDERS = {
    "Antumbra": (antumbra, None),
    "pyViewFactor": (pyviewfactor, pyviewfactor_library),
    "raystrack": (raystrack, raystrack_library),
}
"""Name -> (contender, function that raises InputError if it is not installed)."""

# --- Rows -------------------------------------------------------------------------------------------------------------


def errors(case: Case, factors: np.ndarray) -> dict[str, float | None]:
    """The largest error of factors between sides, and of a row's sum in a closed room."""
    areas = np.bincount(case.surface, _areas(case.soup))
    exchange = areas[:, None] * factors
    worst = 0.0
    for (i, j), exact in case.exact.items():
        first, second = case.side == i, case.side == j
        factor = exchange[np.ix_(first, second)].sum() / areas[first].sum()
        worst = max(worst, abs(float(factor) - exact))
    sums = float(np.abs(factors.sum(1) - 1.0).max()) if case.closed else None
    return {"error": worst, "row_sum_error": sums}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--divisions", type=int, default=6, help="of the sides of rooms")
    parser.add_argument("--samples", type=int, default=4096, help="rays per surface")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", type=Path, help="also write the rows to this file")
    options = parser.parse_args()
    known = {name: make for name, (make, library) in CONTENDERS.items() if library is None or installed(library)}
    rows = []
    for case in cases(options.divisions):
        made = {name: make(case, options.samples) for name, make in known.items()}
        factors = {name: run() for name, run in made.items()}  # compiles
        seconds: dict[str, list[float]] = {name: [] for name in made}
        for _ in range(options.rounds):
            for name, run in made.items():
                start = time.process_time()
                run()
                seconds[name].append(time.process_time() - start)
        ours = float(np.median(seconds["Antumbra"]))
        for name in made:
            median = float(np.median(seconds[name]))
            row = {"case": case.name, "contender": name, "surfaces": len(case.side), "seconds": median}
            row |= {"ratio": median / max(ours, 1e-9), **errors(case, factors[name])}
            rows.append(row)
            sums = "" if row["row_sum_error"] is None else f", row sums {row['row_sum_error']:.1e}"
            print(f"{case.name}: {name} {1e3 * median:.1f} ms of CPU time, error {row['error']:.1e}{sums}")
    if options.json:
        options.json.write_text(json.dumps({"machine": machine(os.cpu_count() or 1), "rows": rows}, indent=1))


if __name__ == "__main__":
    warnings.simplefilter("ignore", DeprecationWarning)
    main()
