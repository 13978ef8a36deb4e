"""Small scenes of instances, each twice: as instances, and flattened."""

import numpy as np

import antumbra as at


def blob(n, seed, scale=1.0):
    """(vertices, faces) of n connected random triangles."""
    rng = np.random.default_rng(seed)
    vertices = rng.normal(size=(n // 2 + 3, 3)) * scale
    return vertices, rng.integers(0, len(vertices), (n, 3)).astype(np.int32)


def block():
    """(vertices, faces) of a box of whole numbers, whose triangles share edges."""
    corners = np.array([(x, y, z) for x in (0, 2) for y in (0, 1) for z in (0, 3)], np.float32)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])


def random_transforms(k, seed, spread=8.0):
    """(k, 3, 4) transforms that rotate, scale, shear and mirror."""
    rng = np.random.default_rng(seed)
    matrices = np.empty((k, 3, 4))
    matrices[:, :, :3] = rng.normal(size=(k, 3, 3)) * 10.0 ** rng.uniform(-1, 0.5, (k, 1, 1))
    matrices[:, :, 3] = rng.uniform(-spread, spread, (k, 3))
    return matrices


def whole_transforms(k, seed, spread=8):
    """(k, 3, 4) transforms of whole numbers, turned by right angles and mirrored; some are equal."""
    rng = np.random.default_rng(seed)
    matrices = np.zeros((k, 3, 4))
    for matrix in matrices:
        matrix[range(3), rng.permutation(3)] = rng.choice([-1.0, 1.0, 2.0], 3)
        matrix[:, 3] = rng.integers(-spread, spread, 3)
    matrices[k // 2] = matrices[0]
    return matrices


def both(meshes, transforms, colours=None):
    """(instances, flattened)."""
    return tuple(at.Scene.from_instances(meshes, transforms, colours, instances=choice) for choice in (True, False))


def random_scenes(seed=0, offset=0.0):
    """Two meshes with 9 and 5 copies, far from the world's origin if there is an offset."""
    transforms = random_transforms(9, seed), random_transforms(5, seed + 1)
    for each in transforms:
        each[:, :, 3] += offset
    return both([blob(60, seed), blob(11, seed + 1, 3.0)], transforms)


def whole_scenes(seed=0):
    """Copies of a box on whole numbers, which share faces, edges and corners, and two of which coincide."""
    return both([block()], [whole_transforms(12, seed)])


def rays_to_corners(scene, flat, n, seed):
    """(origins, directions) of rays, half of them to corners and edges of triangles; exact in the scene's frame."""
    rng = np.random.default_rng(seed)
    triangles = flat.triangles()
    reach = np.abs(triangles.vertices).max()
    origins = (rng.normal(size=(n, 3)) * reach).astype(np.float32)
    origins[::5] = np.round(origins[::5])
    chosen = triangles.vertices[rng.integers(0, len(triangles.vertices), n)]
    weights = rng.choice([0.0, 0.0, 0.5, 1.0], (n, 3))
    weights[:, 0] += weights.sum(1) == 0.0
    targets = (chosen * (weights / weights.sum(1, keepdims=True))[..., None].astype(np.float32)).sum(1)
    targets[::7] = origins[::7] + rng.normal(size=targets[::7].shape)
    directions = (targets - origins).astype(np.float32)
    directions[::6, 0] = 0.0
    directions[~directions.any(1)] = 1.0
    return origins.astype(np.float64) + scene.origin, directions
