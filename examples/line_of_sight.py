"""Lines of sight in a hall, a viewshed, and exact view factors: python examples/line_of_sight.py [FOLDER]

The hall is Sponza if it is in the folder $ANTUMBRA_SCENES, else an atrium.
"""

import os
import sys
import tempfile
from pathlib import Path

import numpy as np

import antumbra as at

folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp())
sponza = Path(os.environ.get("ANTUMBRA_SCENES", ".")) / "sponza_crytek" / "scene.glb"
scene = at.load(sponza) if sponza.exists() else at.procedural("atrium", triangles=20_000)

# 1. Which visitors see each other? Visitors stand on the floor of the hall.
low, high = scene.bounds
size = high - low
rng = np.random.default_rng(1)
floor = low + size * np.array([0.2, 0.0, 0.35]) + size * np.array([0.6, 0.0, 0.3]) * rng.random((12, 3))
floor[:, 1] += 0.12 * size[1]
sight = at.line_of_sight(scene, floor[:, None], floor[None])
print(f"visitors: {sight.visible.sum() - len(floor)} of {sight.visible.size - len(floor)} pairs see each other")
for a, b in np.argwhere(~sight.visible)[:3]:
    blocker = scene.objects[sight.object[a, b]].name
    print(f"  {a} does not see {b}: face {sight.face[a, b]} of {blocker!r}, {sight.distance[a, b]:.4g} away")

# 2. What do they see? Every face of the hall counts the visitors that see its outer side.
viewshed = at.viewshed(scene, at.face_sensors(scene), floor)
area = viewshed.table.sensors.areas
share = area[viewshed.table["seen"] > 0].sum() / area.sum()
viewshed.table.save(folder / "viewshed.csv")
print(f"viewshed: {100 * share:.1f} % of the surfaces are seen by some visitor; written: {folder / 'viewshed.csv'}")


# 3. View factors: how much of the light that leaves a face arrives at another one?
def view_factors(scene: at.Scene) -> tuple[np.ndarray, np.ndarray]:
    """(n, n) view factors between small faces that see each other, from cosines over pi r^2; (n,) their areas."""
    faces = at.face_sensors(scene)
    pairs = at.visibility_matrix(scene, faces).sparse().tocoo()
    away = faces.points[pairs.col] - faces.points[pairs.row]
    r2 = (away * away).sum(1)
    cosines = (away * faces.normals[pairs.row]).sum(1) * -(away * faces.normals[pairs.col]).sum(1) / r2
    factors = np.zeros(pairs.shape)
    factors[pairs.row, pairs.col] = cosines * faces.areas[pairs.col] / (np.pi * r2)
    return factors, faces.areas


def square(n: int, z: float, up: bool, width: float = 1.0) -> np.ndarray:
    """(2 n n, 3, 3): a square in n x n cells around the z axis, that faces up or down."""
    x, y = (width * (axis.ravel() / n - 0.5) for axis in np.meshgrid(np.arange(n), np.arange(n)))
    corner = np.stack([x, y, np.full(n * n, z)], 1)
    u, v = width / n * np.eye(3)[:2]
    triangles = np.stack([[corner, corner + u, corner + u + v], [corner, corner + u + v, corner + v]])
    triangles = triangles.transpose(0, 2, 1, 3).reshape(-1, 3, 3)
    return triangles if up else triangles[:, ::-1]


CLOSED_FORM = 0.199825  # of two parallel unit squares, one unit apart
n, count = 16, 2 * 16 * 16
lower, upper = square(n, 0.0, True), square(n, 1.0, False)
for name, between in (("open", []), ("with a small plate between them", [square(1, 0.5, True, 0.5)])):
    factors, areas = view_factors(at.Scene.from_arrays(np.concatenate([lower, upper, *between])))
    factor = (areas[:count, None] * factors[:count, count : 2 * count]).sum() / areas[:count].sum()
    print(f"view factor of two squares, {name}: {factor:.4f} (open, in closed form: {CLOSED_FORM:.4f})")
    if not between:
        assert abs(factor - CLOSED_FORM) < 1e-3
