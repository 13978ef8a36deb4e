"""Makes the invented data among the example scenes: hills.tif and village.city.json in src/antumbra/examples/.

    python scripts/example_data.py [FOLDER]

The hills are a sum of Gaussians, and the houses have gabled roofs. Needs rasterio.
"""

import json
import sys
from pathlib import Path

import numpy as np

FOLDER = Path(__file__).resolve().parents[1] / "src" / "antumbra" / "examples"
CELL, CELLS = 8.0, 128
WEST, NORTH = 84488.0, 446512.0  # EPSG:28992; the middle is at 85000, 446000
SEED = 5


def heights(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Heights of the hills in metres, in steps of a centimetre."""
    rng, total = np.random.default_rng(SEED), np.zeros(np.broadcast(x, y).shape)
    for _ in range(14):
        centre = rng.uniform((WEST, NORTH - CELL * CELLS), (WEST + CELL * CELLS, NORTH))
        width, height = rng.uniform(70, 190), rng.uniform(8, 34)
        total += height * np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / (2 * width**2))
    return np.round(total, 2)


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


def write_village(path: Path) -> None:
    """Two rows of houses along a bent street, each standing on the lowest point of the hills under it."""
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
