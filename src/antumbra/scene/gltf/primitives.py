"""Mesh primitives: triangles, strips and fans, with the data for skins and morph targets."""

from typing import NamedTuple

import numpy as np

from ...errors import InputError
from ..materials import look_of
from ..meancolour import mean_colours
from ..mesh import Mesh, check_finite, n_faces, used_faces
from .accessors import Accessors
from .draco import decompress
from .fields import Fields
from .materials import Materials

TRIANGLES, STRIP, FAN = 4, 5, 6


class Primitive(NamedTuple):
    """A mesh primitive with triangles."""

    mesh: Mesh
    where: str  # name in errors
    targets: np.ndarray | None  # (t, v, 3) float32 or float64, displacements of morph targets
    joints: np.ndarray | None  # (v, j) int32, indices into the joints of a skin
    weights: np.ndarray | None  # (v, j) float64, their sum 1
    used: np.ndarray | None  # (rows,) bool: the accessors' rows that are vertices here; None: all
    place: int  # index of the primitive in its mesh

    @property
    def triangles(self) -> int:
        return n_faces(self.mesh.positions, self.mesh.faces)


def read_primitive(
    fields: Fields, name: str, accessors: Accessors, materials: Materials, index: int
) -> Primitive | None:
    """A primitive, or None if it has no triangles, as points and lines."""
    decompress(fields, accessors)
    mode = fields.whole("mode", TRIANGLES, high=7)
    attributes = fields.mapping("attributes", len(accessors))
    if mode < TRIANGLES or "POSITION" not in attributes:
        return None
    positions = accessors.floats(attributes["POSITION"], "VEC3")
    faces = _faces(fields, mode, len(positions), accessors)
    if n_faces(positions, faces) == 0:
        return None
    used = None
    if faces is not None:
        faces, used = used_faces(faces, len(positions), fields.where)

    def rows(values: np.ndarray) -> np.ndarray:
        if len(values) != len(positions):
            raise InputError(f"{fields.where} has {len(positions)} positions but {len(values)} of another attribute")
        return np.array(values if used is None else values[used])

    targets = _targets(fields, accessors, rows)
    joints, weights = _influences(attributes, accessors, rows)
    own = rows(positions)
    check_finite(own, fields.where)
    colour, look = _shown(fields, attributes, accessors, rows, faces, materials, own)
    return Primitive(Mesh(name, own, faces, colour, look), fields.where, targets, joints, weights, used, index)


def _faces(fields: Fields, mode: int, n_vertices: int, accessors: Accessors) -> np.ndarray | None:
    """(f, 3) vertex indices; None if every three vertices are a face."""
    index = fields.whole("indices", None, high=len(accessors))
    corners = None if index is None else accessors.whole(index, "SCALAR")[:, 0]
    count = n_vertices if corners is None else len(corners)
    if mode == TRIANGLES:
        if count % 3:
            raise InputError(f"{fields.where} has {count} corners, no multiple of 3; export the mesh triangulated")
        return None if corners is None else corners.reshape(-1, 3)
    if corners is None:
        corners = np.arange(count)
    i = np.arange(max(count - 2, 0))
    if mode == STRIP:
        return np.stack([corners[i], corners[i + 1 + i % 2], corners[i + 2 - i % 2]], axis=1)
    return np.stack([corners[i + 1], corners[i + 2], corners[i * 0]], axis=1)


def _targets(fields: Fields, accessors: Accessors, rows) -> np.ndarray | None:
    targets = []
    for target in fields.objects("targets"):
        index = target.whole("POSITION", None, high=len(accessors))
        targets.append(None if index is None else rows(accessors.floats(index, "VEC3")))
    moving = [t for t in targets if t is not None]
    if not moving:
        return None
    for t in moving:
        check_finite(t, f"{fields.where} morph target")
    still = np.zeros_like(moving[0])
    return np.stack([still if t is None else t for t in targets])


def _influences(attributes: dict[str, int], accessors: Accessors, rows) -> tuple:
    """(joints, weights) of all sets (JOINTS_0, JOINTS_1, ...) side by side. Weights sum to 1."""
    joints, weights = [], []
    for n in range(len(attributes)):
        if f"JOINTS_{n}" not in attributes or f"WEIGHTS_{n}" not in attributes:
            break
        joints.append(rows(accessors.whole(attributes[f"JOINTS_{n}"], "VEC4")))
        weights.append(rows(accessors.finite(attributes[f"WEIGHTS_{n}"], "VEC4")))
    if not joints:
        return None, None
    joint, weight = np.concatenate(joints, axis=1).astype(np.int64), np.concatenate(weights, axis=1)
    joint[weight == 0.0] = 0  # exporters leave arbitrary joints here
    total = weight.sum(axis=1, keepdims=True)
    weight[:, 0] += (total == 0.0)[:, 0]  # a vertex without weights follows its first joint
    return joint.astype(np.int32), weight / np.where(total == 0.0, 1.0, total)


def _shown(fields: Fields, attributes, accessors: Accessors, rows, faces, materials: Materials, rest) -> tuple:
    """(mean base colour, (3,) or (f, 3) float32; Look, or None if the mean says everything)."""

    def of(name: str, *kinds: str) -> np.ndarray | None:
        return rows(accessors.floats(attributes[name], *kinds)) if name in attributes else None

    used = materials.used(fields)
    uv = None if used.material.texture is None else of(used.uv_set, "VEC2")
    uv = None if uv is None else used.placed(uv)
    colours = of("COLOR_0", "VEC3", "VEC4")
    look = look_of(used.material, uv, colours, of("NORMAL", "VEC3"), rest)
    return mean_colours(used.material, faces, uv, colours), look
