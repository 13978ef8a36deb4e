"""Makes the models among the example scenes: mill.glb, room.glb, temple.glb and town.glb in src/antumbra/examples/.

    python scripts/example_models.py [FOLDER]

They consist of the parts of procedural scenes. Each object has a node, and a primitive for each colour.
"""

import io
import json
import struct
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL import Image

from antumbra.generate import palette as p
from antumbra.generate.atrium import column, doorway
from antumbra.generate.city import Style, car, house, lamp
from antumbra.generate.props import agave, bare_tree, barrel, bench, bottle, crate, pot, shelf, tree, vase
from antumbra.generate.shapes import (
    PaletteMesh,
    ScenePart,
    assemble,
    box,
    boxes,
    merge,
    place_copies,
    prism,
    revolve,
)

FOLDER = Path(__file__).resolve().parents[1] / "src" / "antumbra" / "examples"
SEED = 5


class ModelObject(NamedTuple):
    """A named object of a model."""

    name: str
    mesh: PaletteMesh
    spin: float = 0.0  # seconds per turn about the local z axis; 0: it stands still
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)
    turn: float = 0.0  # radians about +y
    scale: float = 1.0
    texture: np.ndarray | None = None  # (h, w, 3) uint8, wound around the y axis


# --- glTF -------------------------------------------------------------------------------------------------------------


class GlbWriter:
    """A binary glTF file in the making."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.json: dict[str, Any] = {"asset": {"version": "2.0", "generator": "scripts/example_models.py"}}
        self.materials: dict[int, int] = {}
        self.meshes: dict[int, int] = {}  # by identity: objects share them

    def append(self, kind: str, entry: dict[str, Any]) -> int:
        """Append an entry to an array of the file, and return its index."""
        entries = self.json.setdefault(kind, [])
        entries.append(entry)
        return len(entries) - 1

    def view(self, data: bytes) -> int:
        """The buffer view of some bytes."""
        self.data += bytes(-len(self.data) % 4)
        start = len(self.data)
        self.data += data
        return self.append("bufferViews", {"buffer": 0, "byteOffset": start, "byteLength": len(data)})

    def accessor(self, values: np.ndarray, kind: str) -> int:
        """The accessor of an array."""
        component = {"float32": 5126, "uint16": 5123, "uint32": 5125}[values.dtype.name]
        entry = {
            "bufferView": self.view(values.tobytes()),
            "componentType": component,
            "count": len(values),
            "type": kind,
        }
        if kind in ("VEC3", "SCALAR") and values.dtype == np.float32:
            entry |= {"min": np.atleast_2d(values.T).min(1).tolist(), "max": np.atleast_2d(values.T).max(1).tolist()}
        return self.append("accessors", entry)

    def material(self, colour: int) -> int:
        """The material of a palette colour."""
        if colour not in self.materials:
            factor = [*(round(float(c), 4) for c in p.PALETTE[colour]), 1.0]
            surface = {"baseColorFactor": factor, "metallicFactor": 0.0, "roughnessFactor": 1.0}
            self.materials[colour] = self.append("materials", {"pbrMetallicRoughness": surface})
        return self.materials[colour]

    def textured(self, picture: np.ndarray) -> int:
        """The material of a picture."""
        packed = io.BytesIO()
        Image.fromarray(picture).save(packed, "PNG", optimize=True)
        image = self.append("images", {"bufferView": self.view(packed.getvalue()), "mimeType": "image/png"})
        texture = self.append("textures", {"source": image})
        surface = {"baseColorTexture": {"index": texture}, "metallicFactor": 0.0, "roughnessFactor": 1.0}
        return self.append("materials", {"pbrMetallicRoughness": surface})

    def primitive(self, mesh: PaletteMesh, faces: np.ndarray) -> dict[str, Any]:
        """Some faces of a mesh, with only the vertices that they use."""
        used, index = np.unique(faces, return_inverse=True)
        kind = np.uint16 if len(used) < 65_535 else np.uint32
        position = self.accessor(np.ascontiguousarray(mesh.vertices[used]), "VEC3")
        return {"attributes": {"POSITION": position}, "indices": self.accessor(index.ravel().astype(kind), "SCALAR")}

    def mesh(self, model: ModelObject) -> int:
        """The mesh of an object."""
        mesh = model.mesh
        if model.texture is None:
            colours = np.unique(mesh.colour)
            primitives = [
                self.primitive(mesh, mesh.faces[mesh.colour == c]) | {"material": self.material(int(c))}
                for c in colours
            ]
        else:
            corners = mesh.vertices[mesh.faces]
            around = np.arctan2(corners[..., 0], corners[..., 2]) / (2.0 * np.pi)
            around -= np.round(around - around[:, :1])  # triangles across the seam
            uv = np.stack([around * 3.0, -corners[..., 1] / 4.0], -1).reshape(-1, 2).astype(np.float32)
            flat = mesh._replace(vertices=corners.reshape(-1, 3), faces=np.arange(corners.size // 3).reshape(-1, 3))
            primitives = [self.primitive(flat, flat.faces) | {"material": self.textured(model.texture)}]
            primitives[0]["attributes"]["TEXCOORD_0"] = self.accessor(uv, "VEC2")
        return self.append("meshes", {"primitives": primitives})

    def add(self, model: ModelObject) -> None:
        """Add the node of an object."""
        if id(model.mesh) not in self.meshes:
            self.meshes[id(model.mesh)] = self.mesh(model)
        entry: dict[str, Any] = {"name": model.name, "mesh": self.meshes[id(model.mesh)]}
        if any(model.place):
            entry["translation"] = [float(each) for each in model.place]
        if model.turn:
            entry["rotation"] = [0.0, float(np.sin(model.turn / 2)), 0.0, float(np.cos(model.turn / 2))]
        if model.scale != 1.0:
            entry["scale"] = [float(model.scale)] * 3
        node = self.append("nodes", entry)
        if model.spin:
            self.animate(node, model.spin)

    def animate(self, node: int, seconds: float) -> None:
        """Turn a node about its z axis."""
        times = np.linspace(0.0, seconds, 5, dtype=np.float32)
        half = np.linspace(0.0, np.pi, 5)
        turns = np.stack([0 * half, 0 * half, np.sin(half), np.cos(half)], 1).astype(np.float32)
        sampler = {"input": self.accessor(times, "SCALAR"), "output": self.accessor(turns, "VEC4")}
        channel = {"sampler": 0, "target": {"node": node, "path": "rotation"}}
        self.append("animations", {"name": "turn", "samplers": [sampler], "channels": [channel]})

    def save(self, path: Path) -> None:
        """Write the file."""
        self.json |= {"scene": 0, "scenes": [{"nodes": list(range(len(self.json["nodes"])))}]}
        self.json["buffers"] = [{"byteLength": len(self.data)}]
        text = json.dumps(self.json, separators=(",", ":")).encode()
        text += b" " * (-len(text) % 4)
        body = bytes(self.data) + bytes(-len(self.data) % 4)
        head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(body))
        path.write_bytes(
            head + struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(body), b"BIN\0") + body
        )


def write(path: Path, objects: Iterable[ModelObject]) -> None:
    """Write a model."""
    writer = GlbWriter()
    for each in objects:
        writer.add(each)
    writer.save(path)


def joined(*parts: ScenePart) -> PaletteMesh:
    """Copies of meshes as one mesh."""
    return assemble(parts)


# --- A mill -----------------------------------------------------------------------------------------------------------


def bricks(rng: np.random.Generator) -> np.ndarray:
    """(128, 128, 3) uint8: rows of bricks that tile."""
    y, x = np.mgrid[:128, :128]
    row = y // 16
    column_of = ((x + 16 * (row % 2)) // 32) % 4
    colour = np.array([176, 104, 78]) + rng.normal(0.0, 12.0, (8, 4, 1)) + rng.normal(0.0, 3.0, (8, 4, 3))
    picture = colour[row, column_of] + rng.normal(0.0, 5.0, (128, 128, 1))
    mortar = (y % 16 < 2) | ((x + 16 * (row % 2)) % 32 < 2)
    picture[mortar] = np.array([196, 186, 170]) + rng.normal(0.0, 5.0, (int(mortar.sum()), 1))
    return np.clip(picture, 0, 255).astype(np.uint8)


def sail(length: float) -> PaletteMesh:
    """A sail of laths from the hub along +y, in the plane z = 0."""
    y = np.arange(1.6, length, 0.42)
    laths = boxes((1.5, 0.07, 0.05), np.stack([0 * y + 0.75, y, 0 * y], 1), p.OAK)
    x = np.linspace(0.3, 1.5, 4)
    rails = boxes((0.05, length - 1.4, 0.04), np.stack([x, 0 * x + (length + 1.3) / 2, 0 * x + 0.04], 1), p.DARK_WOOD)
    return merge(laths, rails, box((0.16, length, 0.16), (0.0, length / 2, 0.0), p.DARK_WOOD))


def mill() -> list[ModelObject]:
    """A windmill whose sails turn in front of its tower."""
    rng = np.random.default_rng(SEED)
    tower = revolve([(2.9, 0.0), (2.75, 1.5), (2.1, 8.0)], 48, p.BRICK)
    cap = revolve([(2.3, 8.0), (2.35, 8.3), (2.0, 9.4), (1.2, 10.3), (0.0, 10.6)], 32, p.SLATE)
    gallery = revolve([(2.6, 3.6), (3.7, 3.75), (3.7, 3.9), (2.6, 3.9)], 32, p.OAK)
    angle = np.arange(24) * (2 * np.pi / 24)
    posts = np.stack([3.55 * np.sin(angle), 0 * angle + 4.4, 3.55 * np.cos(angle)], 1)
    rail = [(3.5, 4.85), (3.6, 4.85), (3.6, 4.95), (3.5, 4.95)]
    fence = merge(boxes((0.08, 1.1, 0.08), posts, p.OAK), revolve([(3.49, 4.9), *rail[1:], (3.49, 4.92)], 48, p.OAK))
    door = merge(
        box((1.3, 2.2, 0.3), (0.0, 1.1, 2.72), p.DARK_WOOD), box((1.6, 0.25, 0.5), (0.0, 2.3, 2.7), p.LIMESTONE)
    )
    windows = boxes(
        (0.7, 0.9, 0.4), [(0.0, 5.9, 2.25), (0.0, 5.9, -2.25), (2.25, 5.9, 0.0), (-2.25, 5.9, 0.0)], p.WHITE
    )
    axle = merge(box((0.4, 0.4, 1.8), (0.0, 0.0, -0.7), p.DARK_WOOD), box((0.6, 0.6, 0.5), (0.0, 0.0, 0.0), p.IRON))
    one, sails = sail(6.2), [axle]
    for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1)):
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]], np.float32)
        sails.append(one._replace(vertices=one.vertices @ turn.T))
    barrels = joined(place_copies(barrel(0.9, 0.35, 0.6), [(3.4, 0, 1.6), (3.1, 0, 2.4), (4.1, 0, 2.2)]))
    return [
        ModelObject("tower", tower, texture=bricks(rng)),
        ModelObject("cap", cap),
        ModelObject("gallery", merge(gallery, fence)),
        ModelObject("door", door),
        ModelObject("windows", windows),
        ModelObject("sails", merge(*sails), spin=4.0, place=(0.0, 8.9, 2.9)),
        ModelObject("barrels", barrels),
    ]


# --- A temple ---------------------------------------------------------------------------------------------------------


def temple() -> list[ModelObject]:
    """A temple of fluted columns around a chamber, under a roof of tiles."""
    across, along, pitch, height, base = 6, 9, 2.2, 6.0, 1.2
    half = np.array([(across - 1) * pitch / 2, (along - 1) * pitch / 2])
    x, z = np.linspace(-half[0], half[0], across), np.linspace(-half[1], half[1], along)
    places = [(a, base, b) for a in x for b in z if abs(a) > half[0] - 0.1 or abs(b) > half[1] - 0.1]
    steps = [
        box((2 * half[0] + 2.4 + k, 0.4, 2 * half[1] + 2.4 + k), (0.0, 1.0 - 0.4 * k, 0.0), p.TRAVERTINE, 0.03)
        for k in range(3)
    ]
    top, size = base + height, 2 * half + 1.5
    beams = [
        box((size[0], 0.7, size[1]), (0, top + 0.35, 0), p.LIMESTONE, 0.02),
        box((size[0] + 0.3, 0.25, size[1] + 0.3), (0, top + 1.45, 0), p.LIMESTONE),
    ]
    frieze = box((size[0] - 0.1, 0.65, size[1] - 0.1), (0, top + 1.0, 0), p.SANDSTONE)
    blocks = np.concatenate(
        [
            [(a, s * size[1] / 2) for a in np.linspace(-half[0], half[0], 11) for s in (-1, 1)],
            [(s * size[0] / 2, b) for b in np.linspace(-half[1], half[1], 17) for s in (-1, 1)],
        ]
    )
    triglyphs = boxes((0.5, 0.6, 0.5), np.insert(blocks, 1, top + 1.0, 1), p.LIMESTONE)
    rise, eaves = 0.24 * size[0], top + 1.5
    pediment = [
        prism(
            [(-size[0] / 2, 0), (0, 0), (size[0] / 2, 0)],
            [(-size[0] / 2, 0.05), (0, rise - 0.1), (size[0] / 2, 0.05)],
            0.5,
            p.SANDSTONE,
        )
    ]
    ends = joined(place_copies(pediment[0], [(0, eaves, s * (size[1] / 2 - 0.5)) for s in (-1, 1)]))
    slope = np.hypot(size[0] / 2 + 0.5, rise + 0.1)
    rows, columns = 22, 15
    tile = merge(
        box((0.98 * slope / columns + 0.05, 0.05, (size[1] + 0.6) / rows * 0.99), colour=p.TERRACOTTA),
        box((slope / columns, 0.09, 0.1), (0, 0.04, 0.4), p.TERRACOTTA),
    )
    s, w = np.meshgrid((np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows - 0.5)
    roof = []
    for side in (-1, 1):
        angle = np.arctan2(rise + 0.1, size[0] / 2 + 0.5) * side
        turn = np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]], np.float32)
        tilted = tile._replace(vertices=tile.vertices @ turn.T)
        at = np.stack(
            [side * (1 - s) * (size[0] / 2 + 0.5), eaves + rise + 0.05 - (1 - s) * (rise + 0.1), w * (size[1] + 0.6)],
            -1,
        ).reshape(-1, 3)
        roof.append(place_copies(tilted, at, shade=p.shades(np.random.default_rng(SEED + side), len(at))))
    inner = 2 * half - 3.2
    walls = boxes(
        [(0.4, height, inner[1]), (0.4, height, inner[1]), (inner[0], height, 0.4)],
        [
            (-inner[0] / 2, base + height / 2, 0),
            (inner[0] / 2, base + height / 2, 0),
            (0, base + height / 2, -inner[1] / 2),
        ],
        p.PLASTER,
    )
    front = doorway(inner[0] - 0.4, 1.1, 2.6, height, 0.4, 16, p.PLASTER)
    front = front._replace(vertices=front.vertices + np.array([0, base, inner[1] / 2], np.float32))
    pots = place_copies(pot(0.9, 0.4, 1.0), [(s * 2.2, base, half[1] + 0.9) for s in (-1, 1)])
    plants = place_copies(
        agave(np.random.default_rng(SEED), 12, 0.9, 4), [(s * 2.2, base + 0.8, half[1] + 0.9) for s in (-1, 1)]
    )
    return [
        ModelObject("steps", merge(*steps)),
        ModelObject("columns", joined(place_copies(column(height, 0.42, 12, 2, 0, p.LIMESTONE), places))),
        ModelObject("entablature", merge(*beams, frieze, triglyphs)),
        ModelObject("pediments", ends),
        ModelObject("roof", joined(*roof)),
        ModelObject("chamber", merge(walls, front)),
        ModelObject("pots", joined(pots, plants)),
    ]


# --- A room -----------------------------------------------------------------------------------------------------------


def room() -> list[ModelObject]:
    """A closed hall with columns, a table, shelves and things on them."""
    rng, (w, h, d) = np.random.default_rng(SEED), (9.0, 3.6, 7.0)
    walls = boxes(
        [(0.2, h, d), (0.2, h, d), (w, h, 0.2), (w, h, 0.2)],
        [(-w / 2, h / 2, 0), (w / 2, h / 2, 0), (0, h / 2, -d / 2), (0, h / 2, d / 2)],
        np.repeat([p.TEAL, p.TERRACOTTA, p.PLASTER, p.PLASTER], 12),
    )
    x, z = np.meshgrid(np.arange(-5.5, 6) * 0.75, np.arange(-4.5, 5) * 0.7)
    at = np.stack([x, 0 * x - 0.05, z], -1).reshape(-1, 3)
    checks = (np.add.outer(np.arange(10), np.arange(12)) % 2).ravel()
    floor = boxes((0.745, 0.1, 0.695), at, np.repeat(np.where(checks, p.SLATE, p.TRAVERTINE), 12))
    under = box((w, 0.1, d), (0, -0.11, 0), p.SLATE)
    ceiling = merge(
        box((w, 0.2, d), (0, h + 0.1, 0), p.WHITE),
        boxes((0.2, 0.25, d), [(k, h - 0.1, 0) for k in (-3, -1, 1, 3)], p.OAK),
    )
    columns = place_copies(column(h, 0.2, 20, 2, 8, p.MARBLE), [(a, 0, b) for a in (-2.9, 2.9) for b in (-1.7, 1.7)])
    table = merge(
        box((2.4, 0.08, 1.1), (0, 0.76, 0), p.OAK, 0.02),
        boxes((0.09, 0.74, 0.09), [(a, 0.37, b) for a in (-1.05, 1.05) for b in (-0.42, 0.42)], p.DARK_WOOD),
    )
    benches = place_copies(bench(2.0, p.OAK), [(0, 0, 1.0), (0, 0, -1.0)])
    case = shelf(2.2, 2.2, 0.4, 5)
    shelves = place_copies(case, [(-4.15, 0, -1.2), (-4.15, 0, 1.4)], np.pi / 2)
    level = (np.arange(5) + 0.3) / 5 * 2.2
    spots = [
        (-4.1, y, c + o)
        for c in (-1.2, 1.4)
        for y in level
        for o in rng.choice(np.arange(-9, 10) / 10.0, 6, replace=False)
    ]
    bottles = place_copies(bottle(0.28, 1.0), spots, shade=p.shades(rng, len(spots)))
    vases = [
        place_copies(vase(0.42 + 0.12 * k, 1.0, c), [(a, y, b)])
        for k, (a, y, b, c) in enumerate([(0.5, 0.8, 0.1, p.BLUE), (-0.6, 0.8, -0.15, p.OCHRE), (0.0, 0.8, 0.2, p.RED)])
    ]
    ball = revolve([(0.3 * np.sin(t), 0.3 - 0.3 * np.cos(t)) for t in np.linspace(0, np.pi, 25)], 40, p.WHITE)
    balls = place_copies(
        ball, [(3.6, 0, -2.6), (3.1, 0, -2.9), (3.85, 0, -2.0), (3.4, 0.5, -2.6)], scale=[1.0, 0.7, 0.8, 0.6]
    )
    pots = place_copies(pot(0.6, 0.3, 1.0), [(3.8, 0, 2.7), (-3.8, 0, 2.9)])
    plants = place_copies(agave(rng, 14, 0.9, 5), [(3.8, 0.55, 2.7), (-3.8, 0.55, 2.9)])
    crates = place_copies(
        crate((0.8, 0.7, 0.7), 5), [(2.0, 0, -3.0), (2.9, 0, 3.0), (2.2, 0.7, -3.0)], [0.1, 0.4, -0.3]
    )
    return [
        ModelObject("walls", walls),
        ModelObject("floor", merge(floor, under)),
        ModelObject("ceiling", ceiling),
        ModelObject("columns", joined(columns)),
        ModelObject("table", table),
        ModelObject("benches", joined(benches)),
        ModelObject("shelves", joined(shelves)),
        ModelObject("bottles", joined(bottles)),
        ModelObject("vases", joined(*vases)),
        ModelObject("balls", joined(balls)),
        ModelObject("plants", joined(pots, plants)),
        ModelObject("crates", joined(crates)),
    ]


# --- A town -----------------------------------------------------------------------------------------------------------


def town() -> list[ModelObject]:
    """Houses along two crossing streets, with gardens, cars and lamps."""
    rng, objects = np.random.default_rng(SEED), []
    ground = merge(
        box((130, 0.4, 110), (0, -0.2, 0), p.GRASS),
        boxes([(130, 0.1, 8), (8, 0.1, 110)], [(0, 0.02, 0), (0, 0.03, 0)], p.ASPHALT),
        boxes([(130, 0.2, 2)] * 2, [(0, 0.05, 5.2), (0, 0.05, -5.2)], p.CONCRETE),
        boxes((2.0, 0.02, 0.25), [(a, 0.08, 0) for a in np.arange(-60, 61, 5.0)], p.WHITE),
    )
    objects.append(ModelObject("ground", ground))
    number = 0
    for side in (-1, 1):
        for row, shift in ((14.0, 0.0), (38.0, 6.0)):
            for x in np.arange(-52.0, 53.0, 15.0):
                if abs(x + shift) < 11.0:
                    continue
                number += 1
                style = Style(
                    2.4, 0.45, False, int(rng.choice([p.PLASTER, p.BRICK, p.OCHRE, p.CLAY, p.WHITE])), p.GLASS, 0.0
                )
                body = house(
                    *rng.uniform((8.0, 8.0), (11.0, 10.0)),
                    int(rng.integers(1, 4)),
                    style,
                    rng,
                    int(rng.choice([p.TERRACOTTA, p.SLATE])),
                )
                turn = rng.normal(0.0, 0.06) + np.pi * (side < 0)
                objects.append(ModelObject(f"house-{number:02}", body, place=(x + shift, 0.0, side * row), turn=turn))
    leafy = [tree(rng, bare_tree(rng, 6.5, 0.35), 700, 0.8, colour) for colour in (p.LEAF, p.PINE)]
    spots = rng.uniform((-60, -52), (60, 52), (400, 2))
    spots = spots[(abs(spots[:, 0]) > 6) & (abs(abs(spots[:, 1]) - 26) < 3.5)][:18]
    for k, (x, z) in enumerate(spots):
        turn, scale = rng.uniform((0.0, 0.8), (6.0, 1.2))
        objects.append(ModelObject(f"tree-{k + 1:02}", leafy[k % 2], place=(x, 0.0, z), turn=turn, scale=scale))
    cars = [car(colour, 1.0) for colour in (p.RED, p.BLUE, p.WHITE)]
    roads = [(-30, 2, 0), (-8, -2, np.pi), (22, 2, 0), (41, -2, np.pi), (2, 28, np.pi / 2), (-2, -33, -np.pi / 2)]
    for k, (x, z, turn) in enumerate(roads):
        objects.append(ModelObject(f"car-{k + 1}", cars[k % 3], place=(x, 0.07, z), turn=turn))
    lantern = lamp(1.0)
    for k, (x, side) in enumerate((x, side) for x in np.arange(-56, 57, 14.0) for side in (-1, 1)):
        objects.append(ModelObject(f"lamp-{k + 1:02}", lantern, place=(x, 0.0, 5.0 * side), turn=side * np.pi / 2))
    return objects


MODELS = {"mill": mill, "room": room, "temple": temple, "town": town}

if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
    for name, make in MODELS.items():
        write(folder / f"{name}.glb", make())
