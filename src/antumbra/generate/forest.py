"""The forest: a path over rolling ground among broadleaf trees, birches, spruces, ferns, grass, rocks and logs.

The triangle budget is shared between terrain, trees and stones; ferns and grass use up the remainder.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..kernels.elementary import atan2, cos, power, sin
from ..kernels.small_matrices import dot, length
from . import palette as p
from .props import bare_tree, conifer, fern, grass, tree
from .shapes import PaletteMesh, ScenePart, assemble, count, grid, merge, place_copies, revolve, steps, tubes

SPACING = 4.6  # metres between trees

_Metres = float | NDArray[np.float64]
"""Coordinates, which broadcast. Functions of them return the same type."""


class _Ground:
    """Rolling ground that rises towards the edges, with a path sunk into it."""

    def __init__(self, rng: np.random.Generator, half: float) -> None:
        self.half = half
        k = 14
        wavelength = rng.uniform(3.0, 22.0, k)
        angle = rng.uniform(0.0, 2.0 * np.pi, k)
        self.wave = np.stack([cos(angle), sin(angle)], axis=1) * (2 * np.pi / wavelength)[:, None]
        self.phase, self.size = rng.uniform(0.0, 2.0 * np.pi, k), 0.022 * wavelength

    def path(self, z: _Metres) -> Any:
        """The x coordinate of the path's centre line at z."""
        return 2.2 * sin(z / 8.0 + 0.4) - 1.0

    def off_path(self, x: _Metres, z: _Metres) -> Any:
        """The distance from the path's centre line, in metres."""
        return np.abs(x - self.path(z))

    def height(self, x: _Metres, z: _Metres) -> Any:
        x, z = np.broadcast_arrays(x, z)
        waves = dot(sin(x[..., None] * self.wave[:, 0] + z[..., None] * self.wave[:, 1] + self.phase), self.size)
        side = np.clip(self.off_path(x, z) / 3.0, 0.0, 1.0)
        bowl = 0.5 * self.half * np.clip(np.sqrt(x * x + z * z) / self.half - 0.25, 0.0, 1.2) ** 2
        return (
            waves * (0.35 + 0.65 * side)
            + 0.35 * side**2 * (3.0 - 2.0 * side)
            + bowl * np.clip(self.off_path(x, z) / (0.5 * self.half), 0.4, 1.0)
        )

    def at(self, xz: NDArray[np.float64], sink: float = 0.0) -> NDArray[np.float64]:
        return np.stack([xz[:, 0], self.height(xz[:, 0], xz[:, 1]) - sink, xz[:, 1]], axis=1)


def forest(triangles: int, seed: int) -> tuple[PaletteMesh, dict[str, Any], dict[str, Any]]:
    """Mesh, camera and light of the forest with about `triangles` triangles."""
    n_trees = max(9, round(90 * np.sqrt(triangles / 300_000)))
    half = SPACING * np.sqrt(n_trees) / 2.0 + 3.0
    ground = _Ground(np.random.default_rng([seed, 0]), half)
    eye = np.array([ground.path(0.62 * half), 0.0, 0.62 * half])
    eye[1] = ground.height(eye[0], eye[2]) + 1.65
    rng = np.random.default_rng([seed, 1])
    parts = [place_copies(_terrain(ground, 0.09 * triangles, rng))]
    parts += _trees(ground, n_trees, 0.58 * triangles, eye, rng)
    parts += _stones(ground, n_trees, 0.05 * triangles, eye, rng)
    parts += _undergrowth(ground, triangles - count(parts), eye, rng)
    ahead = np.array([ground.path(0.0), ground.height(ground.path(0.0), 0.0) + 1.1, 0.0])
    camera = {"position": tuple(eye), "target": tuple(ahead), "up": (0.0, 1.0, 0.0), "vfov": 56.0}
    return assemble(parts), camera, _sun(half)


def _sun(half: float) -> dict[str, Any]:
    """A square light high up on the left, facing the centre."""
    middle = (20.0 + 1.1 * half) * np.array([-0.52, 0.8, -0.22])
    u = np.cross([0.0, 1.0, 0.0], middle)
    v = np.cross(middle, u)
    size = 0.07 * length(middle)
    u, v = (size * a / length(a) for a in (u, v))
    return {"corner": tuple(middle - (u + v) / 2.0), "u": tuple(u), "v": tuple(v)}


def _terrain(ground: _Ground, budget: float, rng: np.random.Generator) -> PaletteMesh:
    """The ground as a grid whose middle columns follow the path."""
    n = max(8, round(np.sqrt(budget / 2)))
    line = np.linspace(-1.0, 1.0, n + 1)
    reach = ground.half + 4.0
    u = reach * (0.35 * line + 0.65 * line * line * line)  # metres from the path; finer near it
    z = reach * line[None]
    x = u[:, None] + ground.path(z) * (1.0 - np.abs(line[:, None]))
    off = np.abs(u[1:] + u[:-1]) / 2.0
    kind = np.where(off < 0.95, p.EARTH, p.MOSS)[:, None]
    points = np.stack(np.broadcast_arrays(x, ground.height(x, z), z), axis=-1)
    return grid(points, kind + p.shades(rng, n * n).reshape(n, n) % 3)


def _scattered(
    ground: _Ground, n: int, rng: np.random.Generator, clear: float, eye: NDArray[np.float64], around: float = 2.5
) -> NDArray[np.float64]:
    """About n positions (k, 2) on a jittered grid, off the path and away from the eye."""
    k = int(np.ceil(np.sqrt(n)))
    line = (np.arange(k) + 0.5) / k * 2.0 - 1.0
    xz = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2) * ground.half
    xz += rng.uniform(-0.8, 0.8, xz.shape) * ground.half / k
    far = length(xz - eye[[0, 2]])
    out: NDArray[np.float64] = xz[(ground.off_path(xz[:, 0], xz[:, 1]) > clear) & (far > around)]
    return out


def _trees(
    ground: _Ground, n: int, budget: float, eye: NDArray[np.float64], rng: np.random.Generator
) -> list[ScenePart]:
    """Oaks near the path, scattered birches, spruces towards the edges."""
    xz = _scattered(ground, n, rng, 1.9, eye, 3.2)
    edge = np.maximum(ground.off_path(xz[:, 0], xz[:, 1]), np.abs(xz[:, 1]) - 0.4 * ground.half) / ground.half
    kind = np.where(rng.random(len(xz)) < 0.08 + 1.1 * edge, 2, np.where(rng.random(len(xz)) < 0.35, 1, 0))
    per_tree = budget / len(xz)
    detail = float(np.clip(np.sqrt(per_tree / 2600.0), 0.12, 3.0))
    parts = []
    for k in range(3):
        chosen = xz[kind == k]
        variants = min(3, max(1, len(chosen) // 4))
        for variant in range(variants):
            at = ground.at(chosen[variant::variants], 0.06)
            if len(at):
                mesh = _kind_of_tree(k, per_tree, detail, rng)
                parts.append(place_copies(mesh, at, rng.uniform(0, 6.3, len(at)), rng.uniform(0.75, 1.25, len(at))))
    return parts


def _kind_of_tree(kind: int, budget: float, detail: float, rng: np.random.Generator) -> PaletteMesh:
    if kind == 2:
        leaves = max(12, int(budget / 4) - 10)
        return conifer(rng, 11.0, leaves, detail)
    bark, colour, height = ((p.BARK, p.LEAF, 9.5), (p.BIRCH, p.LIME, 8.0))[kind]
    bare = bare_tree(rng, height, detail, bark)
    while len(bare.wood.faces) > 0.4 * budget and detail > 0.1:
        detail *= 0.8
        bare = bare_tree(rng, height, detail, bark)
    leaves = max(12, int((budget - len(bare.wood.faces)) / 4))
    return tree(rng, bare, leaves, float(np.clip(10.0 / np.sqrt(leaves), 0.1, 1.2)), colour)


def _stones(
    ground: _Ground, n: int, budget: float, eye: NDArray[np.float64], rng: np.random.Generator
) -> list[ScenePart]:
    """Lumpy rocks, fallen logs and mushrooms."""
    detail = float(np.clip(np.sqrt(budget / (n * 120.0)), 0.25, 4.0))
    parts = []
    for _ in range(2):
        m = steps(7, detail, 3)
        angle = np.linspace(-np.pi / 2, np.pi / 2, m + 1)
        profile = np.stack([cos(angle), 0.62 * sin(angle) + 0.35], axis=1)
        profile[[0, -1], 0] = 0.0
        lump = 1.0 + 0.16 * rng.standard_normal((m + 1, 2 * m))
        rock = revolve(profile, 2 * m, p.ROCK, lump)
        rock.colour[:] += p.shades(rng, len(rock.colour))
        xz = _scattered(ground, n // 3, rng, 1.2, eye)
        parts.append(
            place_copies(rock, ground.at(xz, 0.12), rng.uniform(0, 6.3, len(xz)), rng.uniform(0.15, 0.75, len(xz)))
        )
    t = np.linspace(-1.0, 1.0, steps(4, detail, 2) + 1)
    path = np.stack([0.1 * t * t, 0.12 + 0.03 * sin(3 * t), 1.9 * t], axis=1)
    log = tubes(path[None], 0.2 - 0.03 * t, steps(10, detail, 5), p.BARK)
    xz = _scattered(ground, max(3, n // 12), rng, 2.6, eye, 3.0)
    turn = rng.uniform(0, 6.3, len(xz))
    along = 1.6 * np.stack([sin(turn), cos(turn)], axis=1)
    low, high = ground.at(xz - along, 0.05), ground.at(xz + along, 0.05)
    parts.append(place_copies(log, (low + high) / 2, turn, tilt=-atan2(high[:, 1] - low[:, 1], 3.2)))
    cap = [(0, 0.13), (0.1, 0.13), (0.13, 0.15), (0.1, 0.2), (0.05, 0.23), (0, 0.235)]
    k = steps(8, detail, 5)
    mushroom = merge(revolve([(0.03, -0.05), (0.025, 0.08), (0.03, 0.14)], k, p.PLASTER), revolve(cap, k, p.RED))
    xz = _scattered(ground, n, rng, 0.9, eye)
    parts.append(place_copies(mushroom, ground.at(xz), rng.uniform(0, 6.3, len(xz)), rng.uniform(0.6, 1.6, len(xz))))
    return parts


def _positions_ahead(
    ground: _Ground, n: int, eye: NDArray[np.float64], rng: np.random.Generator, clear: float
) -> NDArray[np.float64]:
    """Positions (n, 2) off the path and in front of the eye, denser near it."""
    xz = np.empty((0, 2))
    while len(xz) < n:
        r = 1.2 + 1.5 * ground.half * power(rng.random(3 * n + 8), 1.25)
        angle = rng.normal(0.0, 0.75, len(r))
        candidates = eye[[0, 2]] + r[:, None] * np.stack([sin(angle), -cos(angle)], axis=1)
        off = ground.off_path(candidates[:, 0], candidates[:, 1])
        keep = (np.abs(candidates).max(axis=1) < ground.half) & (off > clear * rng.uniform(0.5, 1.4, len(candidates)))
        xz = np.concatenate([xz, candidates[keep]])
    return xz[:n]


def _undergrowth(ground: _Ground, budget: int, eye: NDArray[np.float64], rng: np.random.Generator) -> list[ScenePart]:
    """Ferns off the path, and grass for the remaining budget."""
    detail = float(np.clip((max(budget, 1) / 100_000) ** 0.25, 0.5, 2.0))
    parts = []
    for _ in range(3):
        mesh = fern(rng, steps(8, detail, 5), steps(12, detail, 5), 0.85)
        xz = _positions_ahead(ground, int(0.15 * budget / len(mesh.faces)), eye, rng, 1.3)
        parts.append(
            place_copies(mesh, ground.at(xz, 0.02), rng.uniform(0, 6.3, len(xz)), rng.uniform(0.5, 1.3, len(xz)))
        )
    blades, segments, kinds = steps(11, detail, 5), 3, 4
    xz = _positions_ahead(ground, (budget - count(parts)) // (2 * (segments - 1) * blades), eye, rng, 1.0)
    for k in range(kinds):
        mesh, spots = grass(rng, blades, 0.4, 0.13, segments), xz[k::kinds]
        parts.append(
            place_copies(mesh, ground.at(spots), rng.uniform(0, 6.3, len(spots)), rng.uniform(0.4, 1.2, len(spots)))
        )
    return [part for part in parts if len(part.offset)]
