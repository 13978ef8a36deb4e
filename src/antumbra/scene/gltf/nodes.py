"""The node hierarchy: local transforms, and world matrices for all nodes at once."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from ...errors import InputError
from .fields import Fields

SINGULAR = 1e-12
"""A matrix with unit columns and a smaller determinant counts as singular."""


class Nodes(NamedTuple):
    """All nodes of a file, in the pose at rest."""

    fields: list[Fields]
    translation: np.ndarray  # (n, 3) float64
    rotation: np.ndarray  # (n, 4) float64, quaternion x y z w, unit
    scale: np.ndarray  # (n, 3) float64
    matrix: np.ndarray  # (n, 4, 4) float64, used instead of the three above where `fixed`
    fixed: np.ndarray  # (n,) bool
    parent: np.ndarray  # (n,) int64, -1 for a root
    levels: list[np.ndarray]  # node indices by depth, roots first
    visible: np.ndarray  # (n,) bool, whether the default scene reaches the node


def read_nodes(root: Fields) -> Nodes:
    """The nodes of a file, with the nodes of its default scene marked visible."""
    fields = root.objects("nodes")
    n = len(fields)
    children = [f.indices("children", n) for f in fields]
    parent = _parents(fields, children)
    levels = _levels(fields, parent)
    translation = np.array([f.numbers("translation", 3, (0.0, 0.0, 0.0)) for f in fields]).reshape(n, 3)
    rotation = np.array([f.numbers("rotation", 4, (0.0, 0.0, 0.0, 1.0)) for f in fields]).reshape(n, 4)
    scale = np.array([f.numbers("scale", 3, (1.0, 1.0, 1.0)) for f in fields]).reshape(n, 3)
    fixed = np.array(["matrix" in f for f in fields], bool)
    matrix = np.array([_matrix(f) for f in fields]).reshape(n, 4, 4)
    length = np.linalg.norm(rotation, axis=1)
    if not (length > 0.0).all():
        raise fields[int(np.argmin(length))].bad("rotation", "a unit quaternion; zero has no inverse")
    visible = _reached(root, fields, children, parent)
    return Nodes(fields, translation, rotation / length[:, None], scale, matrix, fixed, parent, levels, visible)


def local_matrices(translation, rotation, scale) -> np.ndarray:
    """Translation times rotation times scale ((..., 4, 4) float64). Quaternions are unit x, y, z, w."""
    x, y, z, w = np.moveaxis(np.asarray(rotation, np.float64), -1, 0)
    matrices = np.zeros((*x.shape, 4, 4))
    matrices[..., 0, 0], matrices[..., 1, 1] = 1 - 2 * (y * y + z * z), 1 - 2 * (x * x + z * z)
    matrices[..., 2, 2], matrices[..., 3, 3] = 1 - 2 * (x * x + y * y), 1.0
    matrices[..., 0, 1], matrices[..., 1, 0] = 2 * (x * y - z * w), 2 * (x * y + z * w)
    matrices[..., 0, 2], matrices[..., 2, 0] = 2 * (x * z + y * w), 2 * (x * z - y * w)
    matrices[..., 1, 2], matrices[..., 2, 1] = 2 * (y * z - x * w), 2 * (y * z + x * w)
    matrices[..., :3, :3] *= np.asarray(scale)[..., None, :]
    matrices[..., :3, 3] = translation
    return matrices


def posed(nodes: Nodes, translation, rotation, scale) -> np.ndarray:
    """(n, 4, 4) float64: local matrices of all nodes, from these values or from a node's own matrix."""
    local = local_matrices(translation, rotation, scale)
    local[nodes.fixed] = nodes.matrix[nodes.fixed]
    return local


def world_matrices(nodes: Nodes, local: np.ndarray) -> np.ndarray:
    """(n, 4, 4) float64: each node's transform to world space, computed level by level from the roots."""
    world = local.copy()
    for level in nodes.levels[1:]:
        world[level] = world[nodes.parent[level]] @ local[level]
    return world


def transformed(points: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """`points` ((v, 3)) under each of `matrices` ((k, 4, 4) float64): (k, v, 3) float64.

    The order of operations is fixed. The rounding of a matrix product would depend on the machine's BLAS.
    """
    x, y, z = (points[:, i].astype(np.float64) for i in range(3))
    out = np.empty((len(matrices), len(points), 3))
    for i in range(3):
        a, b, c, d = (matrices[:, i, j, None] for j in range(4))
        out[..., i] = a * x + b * y + c * z + d
    return out


def carriers(nodes: Nodes, what: np.ndarray) -> np.ndarray:
    """(n,) bool: nodes in `what` ((n,) bool) and all their ancestors."""
    carry = what.copy()
    for level in reversed(nodes.levels[1:]):
        np.logical_or.at(carry, nodes.parent[level], carry[level])
    return carry


def singular(matrices: np.ndarray) -> np.ndarray:
    """(n,) bool: which of (n, 4, 4) transforms have no inverse. Their scale does not matter."""
    linear = matrices[:, :3, :3]
    lengths = np.linalg.norm(linear, axis=1)
    with np.errstate(all="ignore"):
        return ~(np.abs(np.linalg.det(linear / lengths[:, None, :])) > SINGULAR)


def check_invertible(nodes: Nodes, needed: np.ndarray) -> None:
    """Raise InputError with the first node of `needed` ((n,) bool) whose transform at rest has no inverse."""
    local = posed(nodes, nodes.translation, nodes.rotation, nodes.scale)
    bad = np.flatnonzero(needed & singular(local))
    if len(bad):
        where = nodes.fields[int(bad[0])].where
        raise InputError(f"{where} has a transform without inverse; give it a scale or matrix that is not flat")


def _matrix(fields: Fields) -> np.ndarray:
    values = fields.numbers("matrix", 16, None)
    if values is None:
        return np.eye(4)
    matrix = values.reshape(4, 4).T  # glTF stores columns
    if not np.allclose(matrix[3], (0.0, 0.0, 0.0, 1.0), atol=1e-6):
        raise fields.bad("matrix", "affine: every fourth number 0, the last 1")
    matrix[3] = 0.0, 0.0, 0.0, 1.0
    return matrix


def _parents(fields: list[Fields], children: list[list[int]]) -> np.ndarray:
    parent = np.full(len(fields), -1, np.int64)
    for i, below in enumerate(children):
        for child in below:
            if parent[child] >= 0 and parent[child] != i:
                parents = f"nodes {parent[child]} and {i}"
                raise InputError(f"{fields[child].where} has two parents, {parents}; glTF nodes form a tree")
            parent[child] = i
    return parent


def _levels(fields: list[Fields], parent: np.ndarray) -> list[np.ndarray]:
    """Node indices by depth. Raises InputError on a cycle of parents."""
    depth = np.full(len(parent), -1, np.int64)
    for i in range(len(parent)):
        path = []
        while i >= 0 and depth[i] == -1:
            depth[i] = -2  # on the current path
            path.append(i)
            i = int(parent[i])
        if i >= 0 and depth[i] == -2:
            raise InputError(f"{fields[i].where} is its own ancestor; glTF nodes form a tree, export the file again")
        base = depth[i] if i >= 0 else -1
        for step, j in enumerate(reversed(path), 1):
            depth[j] = base + step
    order = np.argsort(depth, kind="stable")
    ends = np.searchsorted(depth[order], np.arange(depth.max(initial=-1) + 2))
    return [order[a:b] for a, b in pairwise(ends)]


def _reached(root: Fields, fields: list[Fields], children: list[list[int]], parent: np.ndarray) -> np.ndarray:
    scenes = root.objects("scenes")
    if scenes:
        roots = scenes[root.whole("scene", 0, high=len(scenes))].indices("nodes", len(fields))
    else:
        roots = np.flatnonzero(parent < 0).tolist()
    reached = np.zeros(len(fields), bool)
    while roots:
        node = roots.pop()
        if not reached[node]:
            reached[node] = True
            roots.extend(children[node])
    return reached
