"""Models for the 3D views in the docs, with light baked at their vertices: python scripts/live_models.py NAME OUTPUT.js

A vertex has one bit per sun of a day, exact, and the share of the sky that it sees. `docs/_static/live.js` blends the
bits of the two suns beside the slider, and counts them for the hours of sun. A model is a script file, so that pages
also work from a folder, without a server. The directive ``{live}`` (docs/_ext/live.py) makes the models. Requires
antumbra[sun].
"""

import base64
import json
import sys
import zlib
from datetime import date
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

import antumbra as at
from antumbra.picture.heat_maps import heat_colours
from antumbra.picture.image_files import to_srgb8
from antumbra.sun.sun_positions import zone_of

MAX_SUNS = 64  # bits of a word
_INWARD = 0.02  # shift of a sample from its vertex towards the middle of its faces, so that it is on no edge
_SKY_RAYS = 64


class LiveScene(NamedTuple):
    """A scene to be shown, and how."""

    procedural: str
    triangles: int
    edge: float  # metres: longer edges are split, since shadows are sampled at vertices
    eye: tuple[float, float, float]  # metres
    target: tuple[float, float, float]  # metres: the camera turns around it
    vfov: float  # degrees
    day: date
    step: int  # minutes between two suns, of which there are at most 64
    start: float  # of the slider, as a share of the day
    exposure: float


SPRING, SUMMER = date(2026, 3, 21), date(2026, 6, 21)
SCENES = {
    "atrium": LiveScene("atrium", 20_000, 0.8, (2.0, 2.4, 6.5), (0.0, 2.6, 0.0), 75.0, SUMMER, 20, 0.49, 1.7),
    "city": LiveScene("city", 60_000, 3.0, (95.0, 90.0, 100.0), (0.0, -8.0, 0.0), 42.0, SPRING, 15, 0.3, 1.0),
}
PLACE = at.Place(52.0, 4.36, timezone="Europe/Amsterdam")


class Vertices(NamedTuple):
    """Vertices that faces of one plane and colour share."""

    at: np.ndarray  # (v, 3) float32
    normals: np.ndarray  # (v, 3) float32, unit
    samples: np.ndarray  # (v, 3) float64: where light is measured
    colours: np.ndarray  # (v, 3) uint8, sRGB
    faces: np.ndarray  # (f, 3) uint32


class Light(NamedTuple):
    """Light at vertices."""

    hidden: np.ndarray  # (v,) uint64: bit s is set if sun s is hidden
    sky: np.ndarray  # (v,) uint8: share of the sky that is visible, of 255


def split_edges(corners: np.ndarray, longest: float) -> tuple[np.ndarray, np.ndarray]:
    """Halve the longest edge of each triangle until no edge is longer than `longest`.

    Whether an edge is halved depends on its length alone, so neighbours stay connected.

    corners : (n, 3, 3) float64. Returns (m, 3, 3) corners, and (m,) the triangle each is a part of.
    """
    finished, source = [], np.arange(len(corners))
    while len(corners):
        lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=-1)
        first = lengths.argmax(axis=1)
        short = lengths.max(axis=1) <= longest
        finished.append((corners[short], source[short]))
        order = (first[~short, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(np.take_along_axis(corners[~short], order[..., None], axis=1), 1, 0)
        middle = (a + b) / 2.0
        corners = np.concatenate([np.stack([a, middle, c], 1), np.stack([middle, b, c], 1)])
        source = np.tile(source[~short], 2)
    return tuple(np.concatenate(part) for part in zip(*finished))


def vertices_of(scene: at.Scene, longest: float) -> Vertices:
    """The vertices of a scene whose edges are split."""
    corners, source = split_edges(scene.triangles().vertices.astype(np.float64) + scene.origin, longest)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normals, axis=1)
    corners, source, normals = corners[area > 0.0], source[area > 0.0], (normals / area[:, None])[area > 0.0]
    srgb = to_srgb8(scene.colours[source], 1.0)
    keys = np.concatenate(
        [corners.reshape(-1, 3), np.repeat(np.c_[normals.round(2) + 0.0, srgb], 3, axis=0)], axis=1
    ).astype(np.float32)
    _, first, vertex = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    middle, count = np.zeros((len(first), 3)), np.bincount(vertex, minlength=len(first))
    np.add.at(middle, vertex, np.repeat(corners.mean(axis=1), 3, axis=0))
    places = corners.reshape(-1, 3)[first]
    samples = places + _INWARD * (middle / count[:, None] - places)
    face = first // 3
    return Vertices(places.astype(np.float32), normals[face], samples, srgb[face], vertex.reshape(-1, 3))


def in_order(vertices: Vertices) -> Vertices:
    """The same, renumbered in the order in which faces name them, which compresses better."""
    ids, first, vertex = np.unique(vertices.faces, return_index=True, return_inverse=True)
    order = np.argsort(first, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    columns = (column[ids[order]] for column in vertices[:-1])
    return Vertices(*columns, rank[vertex.reshape(-1, 3)].astype(np.uint32))


def suns_of_day(shown: LiveScene) -> at.Suns:
    """The suns that the slider passes."""
    suns = at.suns_of(PLACE, at.times_of([shown.day], zone_of(PLACE), step=shown.step), "y")
    assert len(suns.directions) <= MAX_SUNS
    return suns


def light_of(scene: at.Scene, vertices: Vertices, suns: at.Suns) -> Light:
    """Bake: one exact bit per vertex and sun."""
    lights = [at.DirectionalLights(-suns.directions), at.AmbientOcclusion(spp=_SKY_RAYS)]
    sun, sky = (at.visibility(scene, vertices.samples, light, normals=vertices.normals) for light in lights)
    return Light(sun.bits[:, 0], np.rint(255.0 * sky.fraction).astype(np.uint8))


def packed(vertices: Vertices, light: Light) -> tuple[bytes, dict[str, Any]]:
    """Compressed columns, and what is needed to read them.

    Columns, little endian, each as the first byte of all rows, then the second of all rows, and so on:

    - positions: uint16 x, y, z, in 65535ths of the bounds
    - hidden suns: uint64
    - faces: three uint32, the zigzag codes of: first vertex minus that of the previous face, second minus first, third
      minus first
    - colours: three uint8, sRGB
    - sky: uint8, of 255
    """
    lower = vertices.at.min(axis=0)
    size = np.maximum(vertices.at.max(axis=0) - lower, 1e-6)
    steps = np.rint((vertices.at - lower) / size * 65535.0).astype("<u2")
    a, b, c = vertices.faces.astype(np.int64).T
    faces = np.stack([np.diff(a, prepend=0), b - a, c - a], axis=1)
    zigzag = (2 * faces ^ (faces >> 63)).astype("<u4")
    columns = steps, light.hidden.astype("<u8"), zigzag, vertices.colours, light.sky
    about = {"vertices": len(steps), "faces": len(vertices.faces), "lower": lower.tolist(), "size": size.tolist()}
    return zlib.compress(b"".join(_byte_planes(column) for column in columns), 9), about


def _byte_planes(column: np.ndarray) -> bytes:
    return np.ascontiguousarray(column).view(np.uint8).reshape(len(column), -1).T.tobytes()


def script_of(name: str) -> str:
    """The script file of a model."""
    shown = SCENES[name]
    suns = suns_of_day(shown)
    scene = at.procedural(shown.procedural, triangles=shown.triangles)
    vertices = in_order(vertices_of(scene, shown.edge))
    data, about = packed(vertices, light_of(scene, vertices, suns))
    about |= {
        "suns": suns.directions.round(5).tolist(),
        "step": shown.step / 60.0,
        "eye": shown.eye,
        "target": shown.target,
    }
    about |= {"vfov": shown.vfov, "start": shown.start, "exposure": shown.exposure}
    about["ramp"] = (heat_colours(np.linspace(0.0, 1.0, 9), 1.0) / 255.0).round(3).tolist()
    about |= {"times": [str(time)[11:16] for time in suns.local], "data": base64.b64encode(data).decode("ascii")}
    return f"(window.liveModels ??= {{}})[{json.dumps(name)}] = {json.dumps(about)};\n"


def write(name: str, path: Path) -> None:
    """Write the script file of a model."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(script_of(name), encoding="utf-8")


if __name__ == "__main__":
    write(sys.argv[1], Path(sys.argv[2]))
