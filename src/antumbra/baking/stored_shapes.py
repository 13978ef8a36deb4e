"""The meshes of a store, for a new glTF file. Its triangles share no vertices, so those at one place are merged."""

from collections.abc import Iterator
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ..engine.scene import AnyScene
from ..kernels.parallel import thread_count
from ..scene.appearance import normals_from_frames
from ..scene.triangle_setup import rows_with_area
from ..store.store_data import StoreData

BAKE_BYTES = 1200
"""Memory for a triangle of a store while it is baked, if it shares no vertex; others take a third to half of this."""

_STEPS = 256.0  # of a normal on each axis: vertices at one place with nearly equal normals are one


class Shape(NamedTuple):
    """Triangles to write."""

    vertices: NDArray[np.float32]  # (v, 3)
    faces: NDArray[np.integer]  # (f, 3)
    normals: NDArray[np.float32] | None  # (v, 3) unit, 0: none
    colours: NDArray[np.float32]  # (f, 3), linear
    numbers: NDArray[np.integer]  # (f,): the faces of the scene

    def part(self, faces: NDArray[np.integer] | NDArray[np.bool_]) -> "Shape":
        """Some of the faces, with the vertices that they use."""
        used, corners = np.unique(self.faces[faces], return_inverse=True)
        normals = None if self.normals is None else self.normals[used]
        return Shape(self.vertices[used], corners.reshape(-1, 3), normals, self.colours[faces], self.numbers[faces])


def stored_shapes(scene: AnyScene) -> Iterator[tuple[str, Shape]]:
    """Yield the name and the shape of each object of a store; of a city, those of all objects together.

    Vertices are in the order in which faces use them. Faces without area are left out.

    Raises
    ------
    InputError
        If the store does not fit in memory.
    """
    data = cast(StoreData, scene.data)
    data.check_all(BAKE_BYTES)
    triangles = data.triangles()
    for name, first, last in _meshes(data):
        rows = rows_with_area(triangles.vertices[first:last], thread_count(None))
        faces = np.arange(first, last) if rows is None else first + rows
        corners, normals = triangles.vertices[faces], None
        if data.stored_looks is not None and (frames := data.stored_looks.of(faces).normals) is not None:
            normals = normals_from_frames(corners.astype(np.float64), frames)
        if len(faces):
            yield name, merged(corners, normals, triangles.colour[faces])._replace(numbers=faces)


def _meshes(data: StoreData) -> Iterator[tuple[str, int, int]]:
    """Yield the name of each mesh, and its faces, from the first to the last, exclusive."""
    objects = data.store.meta.objects
    if objects is None or any(each.type for each in data.objects):  # those of a city are many, and small
        yield data.name, 0, data.n_triangles
        return
    ends = np.cumsum(objects.faces).tolist()
    for of, first, last in zip(objects.of, [0, *ends], ends):
        yield objects.names[of], first, last


def merged(corners: NDArray[np.float32], normals: NDArray[np.float64] | None, colours: NDArray[np.float32]) -> Shape:
    """The shape of triangles, (f, 3, 3), whose corners at one place share a vertex, in the order of their first use.

    normals : (f, 3, 3), unit, 0: none. Only corners with nearly equal ones share a vertex, which has their mean
    """
    places = corners.reshape(-1, 3) + np.float32(0.0)  # -0.0 and 0.0 are one place
    columns = list(places.T)
    if normals is not None:
        columns += list(np.round(_STEPS * normals.reshape(-1, 3)).T)
    number = np.zeros(len(places), np.int64)
    for column in columns:
        number = np.unique(number * len(places) + np.unique(column, return_inverse=True)[1], return_inverse=True)[1]
    first, of_corner = np.unique(number, return_index=True, return_inverse=True)[1:]
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    faces = rank[of_corner].reshape(-1, 3).astype(np.int32)
    means = None
    if normals is not None:
        sums = np.zeros((len(order), 3))
        np.add.at(sums, faces.reshape(-1), normals.reshape(-1, 3))
        length = np.linalg.norm(sums, axis=1, keepdims=True)
        means = (sums / np.where(length > 0.0, length, 1.0)).astype(np.float32)
    return Shape(corners.reshape(-1, 3)[first[order]], faces, means, colours, np.arange(len(faces)))
