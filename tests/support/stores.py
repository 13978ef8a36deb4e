"""Helpers for tests of stores: they build small stores, and read whole ones."""

from typing import NamedTuple

import numpy as np

from antumbra.bvh.compact_tree import bvh_of
from antumbra.bvh.nodes import Bvh
from antumbra.bvh.tree_quality import validate
from antumbra.engine.scene import Scene
from antumbra.engine.store_building import build_store
from antumbra.scene.mesh import Piece
from antumbra.store.store_build import write_store
from antumbra.store.store_file import Store, open_store

CHUNK = 64  # triangles, so that small scenes have many chunks and are sorted in files


class Pieces:
    """A source of given pieces."""

    duration, meshes, objects = 0.0, (), ()

    def __init__(self, *pieces, file="pieces"):
        self._pieces, self.file = pieces, file

    def pieces(self, time):
        yield from self._pieces

    def cameras(self, time):
        return []

    def lights(self, time):
        return []


def scene_of(*pieces) -> Scene:
    return Scene(Pieces(*pieces))


def soup_scene(vertices, colours=None) -> Scene:
    return Scene.from_arrays(np.asarray(vertices, np.float32), colours=colours)


def mesh_piece(rng, n=700, dtype=np.float64, offset=(0, 0, 0), copies=1, one_colour=False) -> Piece:
    """Copies of a mesh of small triangles that share vertices, in random order."""
    positions = rng.normal(size=(n // 2 + 3, 3))
    faces = np.argsort(((positions[:, None] - positions[rng.integers(0, len(positions), n)]) ** 2).sum(2), axis=0)[:3].T
    moved = positions + rng.normal(size=(copies, 1, 3)) * 5 + offset
    colour = rng.random(3 if one_colour else (n, 3)).round(1).astype(np.float32)
    return Piece(moved.astype(dtype), np.ascontiguousarray(faces, np.int32), colour, "mesh")


class Contents(NamedTuple):
    """All triangles of a store, by their index in the scene."""

    vertices: np.ndarray  # (n, 3, 3) float32
    colours: np.ndarray  # (n, 3) float32
    times: np.ndarray  # (n,) int: number of occurrences of each triangle


def contents(store: Store) -> Contents:
    n = store.n_triangles
    found = Contents(np.zeros((n, 3, 3), np.float32), np.zeros((n, 3), np.float32), np.zeros(n, int))
    for k in range(len(store)):
        chunk = store.chunk(k)
        ids, corners = chunk.tree.prim_ids, chunk.tree.corners.reshape(-1, 3, 3)
        found.vertices[ids], found.colours[ids] = corners, chunk.palette[chunk.palette_rows]
        found.times[ids] += 1
    return found


def same_bits(a, b) -> bool:
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


def check_whole(store: Store, scene: Scene) -> None:
    """Check that the store holds exactly the scene's triangles with an area, and its first, in correct chunks."""
    triangles, found = scene.triangles(), contents(store)
    kept = np.arange(scene.n_triangles) if triangles.solid is None else np.union1d([0], triangles.solid)
    assert len(found.times) == scene.n_triangles and store.chunks.triangles.sum() == found.times.sum() == len(kept)
    assert (found.times[kept] == 1).all()
    assert same_bits(found.vertices[kept], triangles.vertices[kept])
    assert same_bits(found.colours[kept], triangles.colour[kept])
    meta = store.meta
    assert same_bits(meta.origin, triangles.origin) and same_bits(meta.bounds, scene.bounds)
    assert (meta.box == [triangles.vertices.min((0, 1)), triangles.vertices.max((0, 1))]).all()
    for k in range(len(store)):
        store.check(k)
        _check_chunk(store, k, triangles.vertices)
    _check_top(store)


def _check_chunk(store, k, vertices):
    tree, chunks = store.chunk(k).tree, store.chunks
    bvh = bvh_of(tree)
    ids = np.sort(bvh.prim_ids)
    validate(bvh._replace(prim_ids=np.searchsorted(ids, bvh.prim_ids).astype(np.int32)), vertices[ids])
    own = vertices[ids]
    assert (chunks.box[k] == [*own.min((0, 1)), *own.max((0, 1))]).all()
    assert same_bits(chunks.root[k], tree.nodes[0]) and len(tree.nodes) == chunks.nodes[k]
    assert len(np.unique(store.chunk(k).palette, axis=0)) == len(store.chunk(k).palette) == chunks.colours[k]


def _check_top(store):
    """Check that the top is a valid tree over the boxes' diagonals, with one chunk in each leaf."""
    links, boxes = store.top.links[:, 12:14], store.chunks.box
    leaves = ~links[(links < 0) & (links != -(2**31))]
    assert (leaves % 8 == 0).all() and sorted(leaves // 8) == list(range(len(store)))
    diagonals = np.stack([boxes[:, :3], boxes[:, 3:], boxes[:, :3]], axis=1)
    bvh = Bvh(store.top.nodes, store.top.links, np.arange(len(store), dtype=np.int32), diagonals.reshape(-1, 9).copy())
    validate(bvh, diagonals)


def with_small_chunks(units, path, max_memory, threads, chunk, progress, stages, tile):
    """`write_store` as `engine.store_building` calls it, with so small chunks that small scenes have several units."""
    return write_store(units, path, max_memory, threads, 16, progress, stages=stages, tile=tile)


def built(tmp_path, *scenes, name="a.antumbra", chunk=CHUNK, **options) -> Store:
    path = tmp_path / name
    build_store(scenes, path, chunk=chunk, **options)
    return open_store(path)
