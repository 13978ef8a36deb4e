"""Compares irradiance with Mitsuba 3: every kind of light, near and far, fully lit and in penumbrae; and skies.

    python benchmarks/radiometry.py [--size N] [--reference N] [--cases TEXT] [--json FILE]

A white floor is lit by one light above or partly below it. The camera is just above the floor, so that lights and
blockers may be close. *Lit* is the mean relative error without a blocker, and *worst* the largest. The last two errors
are the mean difference over the mean irradiance where a card hides part of the light, without a filter, over pixels
that see 2 to 98 % of it. 4,096 samples are four renderings of 1,024, between which the camera moves by a pixel, so that
each point uses four of the sixteen sample sets.

Skies light boxes on a floor. Their rows have the mean relative error, and the mean difference over the mean, of
pictures with the default filter, for several numbers of lights.

The reference is Mitsuba's integrator `direct` at the same points, with --reference samples.
"""

import argparse
import json
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

import antumbra as at
from common import installed, machine
from peers import mitsuba_light

DARK = at.AmbientOcclusion(intensity=0.0, spp=1)  # no ambient light
MOST = 1024
HEIGHT = 0.01  # of the camera


class Case(NamedTuple):
    """A light over the floor, and a card that hides part of it."""

    name: str
    light: at.Light
    card: tuple  # corner and two edges
    extent: float = 2.0  # of the visible part of the floor, around zero


class Row(NamedTuple):
    """The errors of a case, in per cent."""

    case: str
    lit: float
    largest: float
    penumbra: dict[int, float]  # samples -> error
    pixels: int  # in the penumbra


def level(height: float, half: float, x: float = 0.0, z: float = 0.0) -> tuple:
    """A horizontal card around (x, height, z)."""
    return (x - half, height, z - half), (0, 0, 2 * half), (2 * half, 0, 0)


WALL = (-1.1, 0.0, -0.4), (0, 0.25, 0), (0, 0, 0.8)
TILTED = np.array([-np.cos(np.radians(30)), -np.sin(np.radians(30)), 0])
CASES = [
    Case("point, d = 2", at.PointLight((0, 2, 0.3)), level(1.0, 0.3)),
    Case("quad 2 x 2, d = 1.5", at.QuadLight((-1, 1.5, -1), (2, 0, 0), (0, 0, 2)), level(0.5, 0.3)),
    Case("quad 2 x 2, d = 0.3", at.QuadLight((-1, 0.3, -1), (2, 0, 0), (0, 0, 2)), level(0.1, 0.2)),
    Case("quad, half below the horizon", at.QuadLight((-2, -1, -1), (0, 2, 0), (0, 0, 2)), WALL),
    Case("quad, tilted", at.QuadLight((-1.5, 0.2, -1), (0.5, 1.5, 0), (0, 0.3, 2)), level(0.1, 0.3, -0.6)),
    Case("disk, d = 4 R", at.DiskLight((0, 2, 0), (0, 1, 0), 0.5), level(0.8, 0.3)),
    Case("disk, d = R", at.DiskLight((0, 1, 0), (0, 1, 0), 1.0), level(0.4, 0.3)),
    Case("disk, d = R / 2", at.DiskLight((0, 0.5, 0), (0, 1, 0), 1.0), level(0.2, 0.2)),
    Case("disk, 40 % below the horizon", at.DiskLight((-2, 0.2, 0), (1, 0.3, 0), 1.0), WALL),
    *(
        Case(f"sphere, d = {d:g} R", at.SphereLight((0, d, 0), 1.0), level(0.4 * (d - 1), half))
        for d, half in ((1.1, 0.16), (1.5, 0.3), (2.0, 0.42), (3.0, 0.6))
    ),
    Case("sphere, 35 % below the horizon", at.SphereLight((-2.2, 0.3, 0), 1.0), WALL),
    Case("sun of 0.53 degrees", at.DirectionalLight((0.3, -1, 0.1), 0.53), level(20.0, 0.5, -6.0, -2.0), 1.5),
    Case("sun of 40 degrees", at.DirectionalLight((0.3, -1, 0.1), 40.0), level(0.7, 0.3)),
    Case("sun of 90 degrees", at.DirectionalLight((0, -1, 0), 90.0), level(0.4, 0.3)),
    Case("sun of 90 degrees, 30 degrees high", at.DirectionalLight(-TILTED, 90.0), level(0.3, 0.3, -0.3)),
]
FLOOR = np.array([[[-50, 0, -50], [-50, 0, 50], [50, 0, 50]], [[-50, 0, -50], [50, 0, 50], [50, 0, -50]]], float)


def with_card(card: Sequence) -> np.ndarray:
    """(4, 3, 3): the floor and a card."""
    corner, u, v = (np.array(each, float) for each in card)
    return np.concatenate([FLOOR, [[corner, corner + u, corner + u + v], [corner, corner + u + v, corner + v]]])


class FloorPixels(NamedTuple):
    """Pixels of a floor."""

    irradiance: np.ndarray  # (n,)
    fraction: np.ndarray  # (n,)
    points: np.ndarray  # (n, 3)


def ours(vertices: np.ndarray, case: Case, spp: int, size: int) -> FloorPixels:
    """A picture of size x size pixels, the mean of up to four renderings."""
    scene, times = at.Scene.from_arrays(vertices, colours=np.ones(3)), -(-spp // MOST)
    pixel, frames = case.extent / size, []
    for k in range(times):
        middle = k * pixel
        eye, target = (middle, HEIGHT, 0.0), (middle, 0.0, 0.0)
        camera = at.Camera(
            eye, target, (0, 0, -1), width=size + 6, height=size, projection="orthographic", extent=case.extent
        )
        frame = at.render(scene, camera, [case.light, DARK], spp=spp // times, filter=False, antialias=False)
        columns = slice(3 - k, 3 - k + size)
        world = frame.gbuffer.position[:, columns].astype(float) + frame.gbuffer.origin
        frames.append((np.pi * frame.image[:, columns, 0], frame.visibility[0][:, columns], world))
    irradiance, fraction, points = (np.mean([each[i] for each in frames], 0) for i in range(3))
    return FloorPixels(irradiance.ravel(), fraction.ravel(), points.reshape(-1, 3))


def truth(vertices: np.ndarray, light: at.Light, points: np.ndarray, normals, reference: int) -> np.ndarray:
    """(n, 3): irradiance by Mitsuba."""
    return mitsuba_light.irradiance(vertices, light, points, np.broadcast_to(normals, points.shape), reference)


def measure(case: Case, size: int, reference: int) -> Row:
    up = np.array([0.0, 1.0, 0.0])
    lit_floor = ours(FLOOR, case, 16, size // 2)
    right = truth(FLOOR, case.light, lit_floor.points, up, reference)[:, 0]
    lit = np.abs(lit_floor.irradiance / right - 1.0)
    soup, errors = with_card(case.card), {}
    best = ours(soup, case, 4 * MOST, size)
    inside = (best.fraction > 0.02) & (best.fraction < 0.98)
    right = truth(soup, case.light, best.points[inside], up, reference)[:, 0] if inside.any() else np.empty(0)
    for spp in (256, 4 * MOST):
        pixels = best if spp > MOST else ours(soup, case, spp, size)
        if inside.any():
            errors[spp] = 100.0 * float(np.abs(pixels.irradiance[inside] - right).mean() / right.mean())
    return Row(case.name, 100.0 * float(lit.mean()), 100.0 * float(lit.max()), errors, int(inside.sum()))


class SkyRow(NamedTuple):
    """The errors of a sky, in per cent."""

    case: str
    count: int  # of lights
    relative: float
    difference: float
    seconds: float  # of the picture


def town() -> np.ndarray:
    """(n, 3, 3): boxes on a floor."""
    rng = np.random.default_rng(7)
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    size, place = rng.uniform((3, 4, 3), (8, 20, 8), (40, 3)), rng.uniform(-30, 30, (40, 3)) * (1, 0, 1)
    return np.concatenate([FLOOR, *(corners[faces] * s + p - (0, 0.01, 0) for s, p in zip(size, place))])


def sunny() -> np.ndarray:
    """(128, 256, 3): a map with a bright sky and a small sun."""
    height, turn = np.pi * (np.arange(128) + 0.5) / 128, 2 * np.pi * ((np.arange(256) + 0.5) / 256 - 0.5)
    y, x, z = np.cos(height)[:, None], np.sin(height)[:, None] * np.sin(turn), -np.sin(height)[:, None] * np.cos(turn)
    sun = 200.0 * np.exp((0.5 * x + 0.6 * y - 0.62 * z - 1.0) / 0.002)
    return ((np.where(y > 0.0, 0.5 + 0.5 * y, 0.2) + sun)[..., None] * np.ones(3)).astype(np.float32)


SKIES = {"soft daylight": None, "map with a sun": sunny()}


def measure_sky(name: str, counts: Sequence[int], size: int, reference: int) -> list[SkyRow]:
    soup, rows = town(), []
    scene = at.Scene.from_arrays(soup, colours=np.ones(3))
    camera = at.Camera((45, 35, 45), (0, 4, 0), vfov=45, width=4 * size, height=3 * size)
    right = points = None
    for count in counts:
        start = time.process_time()
        frame = at.render(scene, camera, [at.Sky(SKIES[name], count=count), DARK], antialias=False, background=False)
        seconds = time.process_time() - start
        if right is None:
            points = np.random.default_rng(1).choice(np.flatnonzero(frame.mask), size * size)
            world = frame.gbuffer.position.reshape(-1, 3)[points].astype(float) + frame.gbuffer.origin
            normals = frame.gbuffer.normal.reshape(-1, 3)[points].astype(float)
            right = truth(soup, at.Sky(SKIES[name]), world, normals, reference).mean(-1)
        irradiance = np.pi * frame.image.reshape(-1, 3)[points].mean(-1)
        off = np.abs(irradiance - right)
        relative, difference = (off[right > 0.0] / right[right > 0.0]).mean(), off.mean() / right.mean()
        rows.append(SkyRow(name, count, 100.0 * float(relative), 100.0 * float(difference), seconds))
    return rows


def line(row: Row) -> str:
    errors = "".join(f"{row.penumbra[spp]:11.2f}" for spp in sorted(row.penumbra))
    return f"{row.case:36}{row.lit:9.3f}{row.largest:9.3f}{errors}{row.pixels:9}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--size", type=int, default=48, help="width and height of the pictures")
    parser.add_argument("--reference", type=int, default=16_384, help="Mitsuba's samples per point")
    parser.add_argument("--counts", type=int, nargs="+", default=[256, 512, 1024], help="numbers of lights for skies")
    parser.add_argument("--cases", default="", metavar="TEXT", help="only cases with TEXT in their names")
    parser.add_argument("--json", type=Path, help="also write the rows to this file")
    options = parser.parse_args()
    rows: list[Row | SkyRow] = []
    if installed(mitsuba_light.library):
        print(f"errors in %{'':27}{'lit':>9}{'worst':>9}{'256 spp':>11}{'4,096 spp':>11}{'pixels':>9}")
        for case in CASES:
            if options.cases in case.name:
                rows.append(measure(case, options.size, options.reference))
                print(line(rows[-1]), flush=True)
        for name in SKIES:
            if options.cases in name:
                for row in measure_sky(name, options.counts, options.size, options.reference):
                    print(f"{name}, {row.count} lights: {row.relative:.2f} and {row.difference:.2f} %", flush=True)
                    rows.append(row)
    if options.json:
        record = {"machine": machine(0), "size": options.size, "rows": [row._asdict() for row in rows]}
        options.json.write_text(json.dumps(record, indent=1))


if __name__ == "__main__":
    main()
