"""Makes the invented data among the example scenes: hills.tif and village.city.json in src/antumbra/examples/.

    python scripts/example_data.py [FOLDER]

The hills are a sum of Gaussians, and ridges around the valley of the village. The village has houses with gabled roofs,
a street, meadows and trees. Needs rasterio.
"""

import json
import sys
from pathlib import Path

import numpy as np

FOLDER = Path(__file__).resolve().parents[1] / "src" / "antumbra" / "examples"
CELL, CELLS = 8.0, 128
WEST, NORTH = 84488.0, 446512.0  # EPSG:28992; the middle is at 85000, 446000
SEED = 5
VALLEY, RIDGE = 150.0, 90.0  # metres: radius of the valley, height of the ridges around it


def heights(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Heights of the hills in metres, in steps of a centimetre."""
    rng, total = np.random.default_rng(SEED), np.zeros(np.broadcast(x, y).shape)
    for _ in range(14):
        centre = rng.uniform((WEST, NORTH - CELL * CELLS), (WEST + CELL * CELLS, NORTH))
        width, height = rng.uniform(70, 190), rng.uniform(8, 34)
        total += height * np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / (2 * width**2))
    return np.round(total + ridges(x, y), 2)


def ridges(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Ridged multifractal noise in metres, 0 in the valley: each octave is strongest on the ridges before it."""
    rng, total, weight = np.random.default_rng(SEED), 0.0, 1.0
    for octave in range(5):
        angles, phases = rng.uniform(0.0, 2.0 * np.pi, (2, 7))
        lengths = 560.0 * rng.uniform(0.8, 1.3, 7) / 1.9**octave
        ways = (x - WEST)[..., None] * np.cos(angles) + (y - NORTH)[..., None] * np.sin(angles)
        waves = np.sin(2.0 * np.pi * ways / lengths + phases).sum(-1) / 4.0
        weight = weight * np.exp(-1.8 * np.sqrt(waves**2 + 0.01))
        total += weight / 1.7**octave
    beyond = np.clip((np.hypot(x - 85000.0, y - 446000.0) - VALLEY) / (2.0 * VALLEY), 0.0, 1.0)
    return RIDGE * total * beyond**2 * (3.0 - 2.0 * beyond)


def write_hills(path: Path) -> None:
    """The heights at the centres of cells, as a compressed GeoTIFF."""
    import rasterio
    from rasterio.transform import from_origin

    places = (np.arange(CELLS) + 0.5) * CELL
    values = heights(WEST + places[None], NORTH - places[:, None]).astype(np.float32)
    form = {"driver": "GTiff", "width": CELLS, "height": CELLS, "count": 1, "dtype": "float32", "crs": "EPSG:28992"}
    packing = {"compress": "deflate", "predictor": 3, "transform": from_origin(WEST, NORTH, CELL, CELL)}
    with rasterio.open(path, "w", **form, **packing) as file:
        file.write(values, 1)


def house(corners: np.ndarray, base: float, eaves: float, ridge: float, first: int) -> tuple[dict, np.ndarray]:
    """A Building with a gabled roof along its first edge, and its vertices, which start at index `first`."""
    ends = (corners[[1, 3]] + corners[[2, 0]]) / 2  # of the ridge: above the second and the fourth edge
    vertices = np.concatenate([np.c_[corners, np.full(4, z)] for z in (base, eaves)] + [np.c_[ends, np.full(2, ridge)]])
    walls = [[0, 1, 5, 4], [1, 2, 6, 8, 5], [2, 3, 7, 6], [3, 0, 4, 9, 7]]
    surfaces = [[3, 2, 1, 0], *walls, [4, 5, 8, 9], [6, 7, 9, 8]]
    kinds = ["GroundSurface", *["WallSurface"] * 4, *["RoofSurface"] * 2]
    semantics = {"surfaces": [{"type": kind} for kind in kinds], "values": [list(range(len(kinds)))]}
    shell = [[[first + k for k in ring]] for ring in surfaces]
    solid = {"type": "Solid", "lod": "2.2", "boundaries": [shell], "semantics": semantics}
    return {"type": "Building", "attributes": {"height": round(ridge - base, 2)}, "geometry": [solid]}, vertices


def surfaces(points: np.ndarray, faces: list, kind: str, parts: list, first: int) -> tuple[dict, np.ndarray]:
    """An object of triangles, and its vertices, which start at index `first`; parts: a type for each, if not empty."""
    names = sorted(set(parts))
    semantics = {
        "semantics": {"surfaces": [{"type": name} for name in names], "values": [names.index(p) for p in parts]}
    }
    rings = [[[first + k for k in face]] for face in faces]
    geometry = {"type": "MultiSurface", "lod": "2.2", "boundaries": rings, **(semantics if parts else {})}
    return {"type": kind, "geometry": [geometry]}, points


def axis(x: np.ndarray) -> np.ndarray:
    """The northing of the middle of the street."""
    return 446000.0 + 14.0 * np.sin((x - 85000.0) / 60.0)


def ribbon(offsets: list[float]) -> tuple[np.ndarray, list, list[int]]:
    """Triangles of the ground between lines beside the street: points, faces, and the strip of each."""
    x = 85000.0 + np.arange(-105.0, 106.0, 5.0)
    plan = np.array([(east, axis(east) + offset) for east in x for offset in offsets])
    n, faces, strips = len(offsets), [], []
    for k in range(len(x) - 1):
        for j in range(n - 1):
            a, b, c, d = k * n + j, (k + 1) * n + j, (k + 1) * n + j + 1, k * n + j + 1
            faces += [(a, b, c), (a, c, d)]
            strips += [j, j]
    return np.c_[plan, heights(*plan.T)], faces, strips


def tree(x: float, y: float, height: float, sides: int = 7) -> tuple[np.ndarray, list]:
    """A closed crown on a thin trunk: points and faces."""
    ground = float(heights(np.array(x), np.array(y)))
    levels = [(0.18, -0.3), (0.18, 0.3 * height), (0.24 * height, 0.42 * height), (0.28 * height, 0.64 * height)]
    turn = 2.0 * np.pi * np.arange(sides) / sides
    rings = [np.c_[x + r * np.cos(turn), y + r * np.sin(turn), np.full(sides, ground + z)] for r, z in levels]
    points, top = np.concatenate([*rings, [(x, y, ground - 0.3), (x, y, ground + height)]]), len(levels) * sides
    faces = [(top, (k + 1) % sides, k) for k in range(sides)]
    for low in range(0, top - sides, sides):
        for k in range(sides):
            a, b = low + k, low + (k + 1) % sides
            faces += [(a, b, b + sides), (a, b + sides, a + sides)]
    return points, faces + [(top - sides + k, top - sides + (k + 1) % sides, top + 1) for k in range(sides)]


def write_village(path: Path) -> None:
    """Two rows of houses along a bent street, each standing on the lowest point of the hills under it, and trees."""
    rng, objects, vertices = np.random.default_rng(SEED), {}, np.zeros((0, 3))
    for k in range(24):
        along, side = 15.0 * (k // 2 - 6), 1 - 2 * (k % 2)
        turn = 0.25 * np.sin(along / 60.0) + rng.normal(0.0, 0.04)
        axes = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        size = rng.uniform((4.5, 3.5), (6.0, 5.0))
        middle = np.array([85000.0 + along, 446000.0 + 14.0 * np.sin(along / 60.0) + 12.0 * side])
        corners = middle + (np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * size) @ axes
        base = float(heights(*corners.T).min())
        eaves = base + rng.uniform(4.0, 6.5)
        name = f"house-{k + 1:02}"
        objects[name], more = house(corners, base, eaves, eaves + rng.uniform(2.5, 4.0), len(vertices))
        vertices = np.concatenate([vertices, more])

    def add(name: str, points: np.ndarray, faces: list, kind: str, parts: list) -> None:
        nonlocal vertices
        objects[name], more = surfaces(points, faces, kind, parts, len(vertices))
        vertices = np.concatenate([vertices, more])

    points, faces, strips = ribbon([-4.5, -3.0, 3.0, 4.5])
    add("street", points, faces, "Road", [("AuxiliaryTrafficArea", "TrafficArea")[j == 1] for j in strips])
    for name, side in ("south meadow", -1), ("north meadow", 1):
        offsets = sorted(side * offset for offset in (4.5, 7.0, 12.0, 17.0, 24.0, 32.0, 42.0))
        add(name, *ribbon(offsets)[:2], "PlantCover", [])
    for k in range(44):
        x = 84930.0 + rng.uniform(0.0, 170.0)
        offset = 6.2 if k < 14 else rng.uniform(21.0, 40.0)
        x = 84937.0 + 12.0 * k if k < 14 else x
        y = float(axis(np.array(x))) + offset * (1 - 2 * (k % 2))
        add(f"tree-{k + 1:02}", *tree(x, y, rng.uniform(5.0, 6.5) if k < 14 else rng.uniform(6.0, 13.0)),
            "SolitaryVegetationObject", [])  # fmt: skip
    scale, translate = 0.01, vertices.min(axis=0).round(2)
    whole = np.round((vertices - translate) / scale).astype(int)
    city = {
        "type": "CityJSON",
        "version": "2.0",
        "transform": {"scale": [scale] * 3, "translate": translate.tolist()},
        "metadata": {"referenceSystem": "https://www.opengis.net/def/crs/EPSG/0/7415", "title": "An invented village"},
        "CityObjects": objects,
        "vertices": whole.tolist(),
    }
    path.write_text(json.dumps(city, separators=(",", ":")) + "\n", encoding="utf-8")


if __name__ == "__main__":
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER
    write_hills(folder / "hills.tif")
    write_village(folder / "village.city.json")
