"""Any-hit and closest-hit queries for arrays of rays: python examples/rays.py"""

import numpy as np

import antumbra as at

scene = at.procedural("museum", triangles=10_000)
centre = scene.bounds.mean(axis=0)

# Uniformly distributed directions. They need not be unit vectors: t is in units of their length.
rng = np.random.default_rng(0)
directions = rng.normal(size=(100_000, 3))
directions /= np.linalg.norm(directions, axis=1, keepdims=True)

# Any hit: one origin broadcasts against all directions.
for reach in (1.0, 3.0, 10.0):
    blocked = scene.occluded(centre, directions, tmax=reach)
    print(f"blocked within {reach:4.1f}: {blocked.mean():6.1%}")

# Closest hit: t and face (inf and -1 on a miss), and u, v on the face.
hit = scene.closest_hit(centre, directions)
hit_any = hit.face >= 0
print(f"hits: {hit_any.mean():.1%}, nearest {hit.t.min():.3f}, median {np.median(hit.t[hit_any]):.3f}")

# Rays from the hits, which skip the faces that they start on.
corners = scene.triangles().vertices[hit.face[hit_any]].astype(np.float64) + scene.origin
u, v = hit.u[hit_any, None], hit.v[hit_any, None]
points = corners[:, 0] + u * (corners[:, 1] - corners[:, 0]) + v * (corners[:, 2] - corners[:, 0])
open_sky = ~scene.occluded(points, (0.0, 1.0, 0.0), skip_face=hit.face[hit_any])
print(f"of the points hit, {open_sky.mean():.1%} have nothing above them")
