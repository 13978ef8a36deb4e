"""Trees of instances: one wide BVH per mesh, and one over the exact boxes of all copies.

A mesh is stored relative to the centre of its bounds, in float32. A ray enters a copy by the map

    x -> N (x - b)      N: the computed inverse of the copy's matrix,  b: the centre of the copy, rounded

which takes the flattened float32 triangles of the copy to within `shift` of the stored ones. docs/design/instances.md
derives this bound; box and line tests in a mesh's tree allow for it.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..kernels.jit import F32Ptr, F64Ptr, I32Ptr, I64Ptr, inlined
from ..kernels.simd import f32_at, f64_at, get, i32_at, ptr
from ..scene.instance_data import InstanceData
from ..scene.instances import InstancedMesh
from ..scene.scene_bounds import flush_to_zero
from . import binned_sah
from .nodes import EMPTY, LINKS, NODE_WORDS, WIDTH, Bvh, Reach, WideBvh, aligned_empty, wide_leaf
from .reinsertion import reinsert
from .wide_bvh import reach_of, widen

# --- Trees of meshes --------------------------------------------------------------------------------------------------


Build = Callable[[NDArray[np.float32], int], Bvh]
"""A function of vertices, (n, 3, 3) float32, and a number of threads."""


class MeshTree(NamedTuple):
    """A mesh with its tree, in the frame at the centre of its bounds."""

    wide: WideBvh
    centre: NDArray[np.float64]  # (3,)
    reach: float  # largest distance of a vertex from the centre along an axis
    furthest: float  # largest magnitude of a coordinate in object space
    corners: NDArray[np.float64]  # (n, 9): lane of the tree's groups -> the corners of the face in object space
    ids: NDArray[np.int32]  # (n,): lane -> face of the mesh; of unused lanes, any
    part: NDArray[np.int32]  # (n,): lane -> part of the face


_NO_CORNERS = np.empty((0, 9), np.float32)


def mesh_tree(mesh: InstancedMesh, build: Build, threads: int) -> MeshTree:
    """Build the tree of a mesh that has faces."""
    positions = mesh.positions.astype(np.float64)
    centre = (positions.min(0) + positions.max(0)) / 2.0
    relative = positions - centre
    wide = widen(build(np.ascontiguousarray(relative.astype(np.float32)[mesh.faces]), threads), threads)
    ids = wide.bvh.prim_ids[np.maximum(wide.slots.reshape(-1), 0)]
    corners = positions[mesh.faces[ids]].reshape(-1, 9)
    part = np.repeat(np.arange(len(mesh.parts) - 1, dtype=np.int32), np.diff(mesh.parts))[ids]
    reach, furthest = float(np.abs(relative).max()), float(np.abs(positions).max())
    wide = wide._replace(bvh=wide.bvh._replace(corners=_NO_CORNERS))  # not used
    return MeshTree(wide, centre, reach, furthest, corners, ids, part)


# --- Error bounds of copies, see docs/design/instances.md -------------------------------------------------------------


_ROUNDED = 2.0**-23  # more than float32 rounding, of relative size 2^-24
_COMPUTED = 2.0**-49  # more than the float64 operations of a transform, its recentring and the map back
_FLUSHED = 2.0**-109  # more than coordinates that become 0
_MARGIN = 1.0 + 2.0**-20


class CopyMap(NamedTuple):
    """The maps from the scene's frame into copies: x -> linear (x - centre)."""

    linear: NDArray[np.float64]  # (k, 3, 3): N
    centre: NDArray[np.float64]  # (k, 3): b
    norm: NDArray[np.float64]  # (k,): at least the maximum norm of N
    shift: NDArray[np.float64]  # (k,): at least the distance of mapped triangles from stored ones, along each axis


def copy_map(matrices: NDArray[np.float64], mesh: MeshTree, origin: NDArray[np.float64], far: np.ndarray) -> CopyMap:
    """The maps of copies of one mesh.

    matrices : (k, 3, 4)
    far : (k,): largest magnitude of a coordinate of each copy in the scene's frame

    Raises
    ------
    InputError
        If a matrix has no inverse.
    """
    forward, moved = matrices[:, :, :3], matrices[:, :, 3]
    centre = forward @ mesh.centre + moved - origin
    try:
        linear = np.linalg.inv(forward)
    except np.linalg.LinAlgError as error:
        raise InputError("a transform has no inverse; load the scene with instances=False") from error
    norm = np.abs(linear).sum(2).max(1) * _MARGIN
    size = np.abs(forward).sum(2).max(1) * mesh.furthest + np.abs(moved).max(1) + np.abs(origin).max()
    inexact = np.abs(linear @ forward - np.eye(3)) + _COMPUTED * (np.abs(linear) @ np.abs(forward))
    world = _ROUNDED * far + 2.0 * _COMPUTED * size + _FLUSHED
    # Eq. (3) of docs/design/instances.md
    shift = (inexact.sum(2).max(1) + _ROUNDED) * mesh.reach + norm * world
    return CopyMap(*(np.asarray(each, np.float64) for each in (linear, centre, norm, shift * _MARGIN)))


# --- The tree over copies ---------------------------------------------------------------------------------------------


_NOWHERE = np.float32(3e38)


def top_bvh(boxes: NDArray[np.float32], threads: int) -> Bvh:
    """A binary BVH over boxes, (k, 2, 3), with one box a leaf.

    Since builders take triangles, each box is replaced by a zero-area triangle with the same bounds.
    """
    lower, upper = boxes[:, 0], boxes[:, 1]
    return reinsert(binned_sah.build(np.stack([lower, upper, lower], axis=1), threads, max_leaf=1), threads)


def top_tree(bvh: Bvh, boxes: NDArray[np.float32], threads: int) -> NDArray[np.float32]:
    """(n, 64): the nodes of the wide BVH of a `top_bvh`. A link < 0 is ``~box``, or EMPTY for a missing child.

    Rays that are too long or too far away for float32 enter missing children too, and must recognise them.
    """
    lower, upper = boxes[:, 0], boxes[:, 1]
    wide = widen(bvh, threads)
    n, counts = len(wide.nodes), np.count_nonzero(wide.slots >= 0, axis=1)
    ids = np.where(wide.slots >= 0, wide.bvh.prim_ids[np.maximum(wide.slots, 0)], 0)
    nodes = aligned_empty((n + len(counts), NODE_WORDS), "f4")
    nodes[:n] = wide.nodes
    links = nodes.view(np.int32)[:, LINKS : LINKS + WIDTH]
    leaf, (group, size) = links[:n] < 0, wide_leaf(links[:n])
    single = ~ids[np.where(leaf, group, 0), 0]
    links[:n] = np.where(leaf, np.where(size > 1, n + group, np.where(size == 1, single, EMPTY)), links[:n])
    there = wide.slots >= 0
    nodes[n:, LINKS + WIDTH :] = 0.0
    links[n:] = np.where(there, ~ids, EMPTY)
    for axis in range(3):
        nodes[n:, 16 * axis : 16 * axis + 8] = np.where(there, lower[ids, axis], _NOWHERE)
        nodes[n:, 16 * axis + 8 : 16 * axis + 16] = np.where(there, upper[ids, axis], -_NOWHERE)
    return nodes


# --- All trees of a scene ---------------------------------------------------------------------------------------------


MESH_WORDS = 8
NODES, GROUPS, CORNERS, IDS, PART, REACH = range(6)  # words of a mesh


class InstanceArrays(NamedTuple):
    """The trees of a scene of instances, for kernels. The `InstanceTrees` that made it keeps their memory alive."""

    nodes: NDArray[np.float32]  # (n, 64), 64-byte aligned: the tree over the copies, see `top_tree`
    links: NDArray[np.int32]  # (n, 64), the same memory
    meshes: NDArray[np.int64]  # (m, MESH_WORDS): addresses of each mesh's arrays, and numbers
    mesh: NDArray[np.int32]  # (k,): mesh of each copy
    matrices: NDArray[np.float64]  # (k, 12): object-to-world transforms, row by row
    maps: NDArray[np.float64]  # (k, 15): `CopyMap`: linear row by row, centre, its largest magnitude, norm, shift
    rows: NDArray[np.int64]  # (k,): first of each copy's `starts`
    starts: NDArray[np.int64]  # (s,): for each part of each copy, scene index of face i of the mesh, minus i
    origin: NDArray[np.float64]  # (3,)
    reach: Reach  # of the copies


class InstancePointers(NamedTuple):
    """Pointers to the arrays of an `InstanceArrays`."""

    nodes: F32Ptr
    links: I32Ptr
    meshes: I64Ptr
    mesh: I32Ptr
    matrices: F64Ptr
    maps: F64Ptr
    rows: I64Ptr
    starts: I64Ptr
    origin: F64Ptr
    reach: Reach


@inlined
def instance_pointers(arrays):
    """Pointers to the arrays of an `InstanceArrays`, which must outlive them."""
    return InstancePointers(
        ptr(arrays.nodes), ptr(arrays.links), ptr(arrays.meshes), ptr(arrays.mesh), ptr(arrays.matrices),
        ptr(arrays.maps), ptr(arrays.rows), ptr(arrays.starts), ptr(arrays.origin), arrays.reach,
    )  # fmt: skip


class MeshPointers(NamedTuple):
    """Pointers to the arrays of a mesh and its wide tree."""

    nodes: F32Ptr  # float32 *, 64 per node
    links: I32Ptr  # int32 *, the same memory
    groups: F32Ptr  # float32 *, 80 per group
    corners: F64Ptr  # float64 *, 9 per lane, in object space
    ids: I32Ptr  # int32 *, lane -> face of the mesh
    part: I32Ptr  # int32 *: lane -> part of the face


@inlined
def mesh_pointers(scene, mesh):
    """The `MeshPointers` of a mesh of an `InstancePointers`."""
    at, words = np.int64(mesh) * MESH_WORDS, scene.meshes
    nodes = get(words, at + NODES)
    return MeshPointers(
        f32_at(nodes), i32_at(nodes), f32_at(get(words, at + GROUPS)), f64_at(get(words, at + CORNERS)),
        i32_at(get(words, at + IDS)), i32_at(get(words, at + PART)),
    )  # fmt: skip


@inlined
def mesh_reach(scene, mesh):
    """Largest magnitude of a coordinate of a mesh's tree, float32."""
    return get(f32_at(get(scene.meshes, np.int64(mesh) * MESH_WORDS + REACH)), 0)


class InstanceTrees:
    """The trees of a scene of instances.

    arrays : InstanceArrays
    meshes : dict of int to MeshTree
        Those of the meshes that have faces.
    top : Bvh
        The binary tree over the copies, which are its primitives; without corners.
    """

    def __init__(self, data: InstanceData, build: Build, threads: int):
        instances, n = data.instances, len(data.instances.mesh)
        counts = np.array([len(mesh.faces) for mesh in instances.meshes])
        filled = np.flatnonzero(counts[instances.mesh] > 0)
        self.meshes = {k: mesh_tree(instances.meshes[k], build, threads) for k in np.flatnonzero(counts).tolist()}
        self._reaches = {k: np.array([max(tree.wide.reach)], np.float32) for k, tree in self.meshes.items()}
        boxes = flush_to_zero((data.boxes[filled] - data.origin).astype(np.float32))
        far, maps = np.abs(boxes).max(axis=(1, 2)).astype(np.float64), np.zeros((n, 15))
        for k, tree in self.meshes.items():
            at = instances.mesh[filled] == k
            of_mesh = copy_map(instances.matrices[filled[at]], tree, data.origin, far[at])
            maps[filled[at]] = np.concatenate(
                [
                    of_mesh.linear.reshape(-1, 9),
                    of_mesh.centre,
                    np.abs(of_mesh.centre).max(1, keepdims=True),
                    of_mesh.norm[:, None],
                    of_mesh.shift[:, None],
                ],
                axis=1,
            )
        top = top_bvh(boxes, threads)
        nodes = top_tree(top, boxes, threads)
        self.top = top._replace(prim_ids=filled[top.prim_ids].astype(np.int32), corners=_NO_CORNERS)
        links = nodes.view(np.int32)[:, LINKS : LINKS + WIDTH]
        to_copy = (links < 0) & (links != EMPTY)
        links[to_copy] = ~filled[~links[to_copy]].astype(np.int32)
        first = np.concatenate([instances.meshes[k].parts[:-1] for k in instances.mesh])
        self.arrays = InstanceArrays(
            nodes,
            nodes.view(np.int32),
            np.array([self._words(k) for k in range(len(counts))], np.int64).reshape(-1, MESH_WORDS),
            instances.mesh.copy(),
            instances.matrices.reshape(-1, 12).copy(),
            maps,
            instances.rows[:-1].copy(),
            instances.starts - first,
            data.origin.copy(),
            reach_of(boxes),
        )

    def _words(self, k: int) -> list[int]:
        """The words of a mesh in `InstanceArrays.meshes`; 0 for a mesh without faces, which no ray enters."""
        if k not in self.meshes:
            return [0] * MESH_WORDS
        tree = self.meshes[k]
        wide = tree.wide
        arrays = wide.nodes, wide.groups, tree.corners, tree.ids, tree.part, self._reaches[k]
        return [*(each.ctypes.data for each in arrays), 0, 0]
