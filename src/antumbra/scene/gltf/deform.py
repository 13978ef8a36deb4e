"""Vertices that move within their mesh: morph targets and skins, in float64."""

from typing import NamedTuple

import numpy as np

from ...errors import InputError
from .accessors import Accessors
from .fields import Fields
from .primitives import Primitive


class Skin(NamedTuple):
    """Joints and their inverse bind matrices."""

    joints: np.ndarray  # (j,) int64, node indices
    inverse_bind: np.ndarray  # (j, 4, 4) float64
    where: str  # name in errors


def read_skins(root: Fields, accessors: Accessors, n_nodes: int) -> list[Skin]:
    skins = []
    for fields in root.objects("skins"):
        joints = np.array(fields.indices("joints", n_nodes), np.int64)
        inverse = np.tile(np.eye(4), (len(joints), 1, 1))
        index = fields.whole("inverseBindMatrices", None, high=len(accessors))
        if index is not None:
            stored = accessors.finite(index, "MAT4")
            if len(stored) < len(joints):
                raise InputError(f"{fields.where} has {len(joints)} joints but {len(stored)} inverseBindMatrices")
            inverse = stored[: len(joints)].reshape(-1, 4, 4).transpose(0, 2, 1)  # stored by columns
        skins.append(Skin(joints, inverse, fields.where))
    return skins


def check_skin(primitive: Primitive, skin: Skin) -> None:
    """Raise InputError if the primitive uses joints that the skin does not have."""
    if primitive.joints is not None and primitive.joints.size and primitive.joints.max() >= len(skin.joints):
        raise InputError(
            f"{primitive.where} uses joint {primitive.joints.max()}, but {skin.where} has {len(skin.joints)}"
        )


def morphed(primitive: Primitive, weights: np.ndarray) -> np.ndarray:
    """Positions ((v, 3)) plus the weighted displacements of the morph targets."""
    if primitive.targets is None:
        return primitive.mesh.positions
    positions = primitive.mesh.positions.astype(np.float64)
    for weight, target in zip(weights, primitive.targets):
        if weight != 0.0:
            positions += weight * target.astype(np.float64)
    return positions


def skinned(positions: np.ndarray, primitive: Primitive, skin: Skin, world: np.ndarray) -> np.ndarray:
    """World positions ((1, v, 3) float64) of a skinned mesh: the weighted mean over its joints' transforms.

    `world` ((n, 4, 4)) has the nodes' world matrices. The matrix of the mesh's own node is not used.
    """
    assert primitive.joints is not None and primitive.weights is not None
    matrices = (world[skin.joints] @ skin.inverse_bind)[:, :3]
    homogeneous = np.concatenate([positions.astype(np.float64), np.ones((len(positions), 1))], axis=1)
    out = np.zeros((1, len(positions), 3))
    for joint, weight in zip(primitive.joints.T, primitive.weights.T):
        out[0] += weight[:, None] * np.einsum("vij,vj->vi", matrices[joint], homogeneous)
    return out
