"""The glTF reader: `read_gltf` returns a file as a source of geometry, cameras and lights over time.

Each node with a mesh becomes a `MeshNode`. At every time, its primitives are deformed and transformed to world space.
"""

from collections.abc import Generator, Iterable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...base.wording import counted
from ...kernels.small_matrices import product
from ...scene.camera import Camera
from ...scene.instances import (
    MAX_TRIANGLES,
    InstancedMesh,
    InstanceSet,
    copies_in_batches,
    instance_set,
    instanced_mesh,
    singular,
)
from ...scene.lights import Light
from ...scene.mesh import Mesh, MeshInfo, ObjectInfo, Piece
from ..face_ranges import FACES_PER_PIECE
from ..json_fields import Fields
from .accessors import Accessors
from .gltf_file import GltfDocument, open_gltf
from .gltf_materials import GltfMaterials, ignored_fields
from .gltf_meshes import (
    Primitive,
    PrimitiveReader,
    Skin,
    check_skin,
    join_small_primitives,
    morphed,
    read_skins,
    skinned,
    triangles_of,
)
from .gltf_nodes import (
    GltfViews,
    Nodes,
    Track,
    check_invertible,
    local_matrices,
    posed_matrices,
    read_nodes,
    read_tracks,
    sample_track,
    with_ancestors,
    world_matrices,
)


class MeshNode(NamedTuple):
    """A mesh at a node. Each of its copies is an object of the scene."""

    first: int  # object index of the first copy
    node: int
    primitives: list[Primitive]
    runs: list[Primitive]  # the primitives, with runs of small ones merged
    weights: NDArray[np.float64]  # (t,) float64, weights of the morph targets at rest
    skin: Skin | None
    copies: NDArray[np.float64] | None  # (k, 4, 4) float64, transforms of EXT_mesh_gpu_instancing relative to the node
    on_disk: list[PrimitiveReader]  # of a file on the disk, instead of `primitives` and `runs`

    @property
    def n_copies(self) -> int:
        return 1 if self.copies is None else len(self.copies)

    @property
    def parts(self) -> list[Primitive] | list[PrimitiveReader]:
        """The primitives, in memory or on the disk."""
        return self.primitives or self.on_disk

    def read(self) -> Iterator[tuple["MeshNode", Primitive]]:
        """The primitives in the order of faces, each with this node, or with a copy if its faces are read in ranges."""
        yield from ((self, run) for run in self.runs)
        for primitive in self.on_disk:
            n = primitive.triangles
            for one in [self] if n <= FACES_PER_PIECE else self._each_copy():
                for first in range(0, n, FACES_PER_PIECE):
                    read = primitive.read(np.arange(first, min(first + FACES_PER_PIECE, n)))
                    if self.skin is not None:
                        check_skin(read, self.skin)
                    yield one, read

    def _each_copy(self) -> Iterator["MeshNode"]:
        if self.copies is None:
            yield self
            return
        for k in range(len(self.copies)):
            yield self._replace(first=self.first + k, copies=self.copies[k : k + 1])


_COPY_BYTES = 600  # of memory per instance: its transform, object and name


class PlacedPrimitive(NamedTuple):
    """A primitive of a mesh at a node, at one moment, in world space."""

    node: int
    primitive: Primitive
    matrix: NDArray[np.float64]  # (4, 4) float64, the node's transform to world space
    skinned: bool
    vertices: NDArray[np.float64]  # (k, v, 3) float64, world; k copies
    first: int  # object index of the first copy
    linear: NDArray[np.float64] | None  # (k, 3, 3) float64: linear parts of the copies' transforms; None: skinned


_Pose: TypeAlias = tuple[NDArray[np.float64], dict[int, NDArray[np.float64]]]


class GltfSource:
    """Geometry, cameras and lights of a glTF file (see `antumbra.scene.mesh.Source`).

    Faces are ordered by node in the file, then by primitive, then by instance.
    """

    def __init__(
        self,
        file: str,
        meshes: list[MeshInfo],
        objects: list[ObjectInfo],
        nodes: Nodes,
        draws: list[MeshNode],
        tracks: list[Track],
        views: GltfViews,
    ) -> None:
        self.file, self.meshes, self.objects = file, meshes, objects
        self.duration = max([0.0, *(float(t.times[-1]) for t in tracks)])
        self._nodes, self._draws, self._tracks, self._views = nodes, draws, tracks, views
        self.animation: str | None = None  # the clip that plays; None: all at once
        self._posed: tuple[float, _Pose] | None = None  # the last pose: deep hierarchies take long to pose

    def __getstate__(self) -> dict[str, Any]:
        return self.__dict__ | {"_posed": None}

    def pieces(self, time: float) -> Generator[Piece, None, None]:
        for placed in self._placed(time, (each for draw in self._draws for each in draw.read())):
            mesh = placed.primitive.mesh
            yield Piece(
                placed.vertices, mesh.faces, mesh.colour, placed.primitive.where, first=placed.first, look=mesh.look,
                linear=placed.linear, is_range=placed.primitive.is_range, numbers=mesh.numbers,
            )  # fmt: skip

    @property
    def in_memory(self) -> bool:
        return not any(draw.on_disk for draw in self._draws)

    def placed(self, time: float) -> Iterator["PlacedPrimitive"]:
        """The primitives at their nodes, in the order of `pieces`."""
        return self._placed(time, ((draw, primitive) for draw in self._draws for primitive in draw.primitives))

    def _placed(self, time: float, primitives: Iterable[tuple[MeshNode, Primitive]]) -> Iterator["PlacedPrimitive"]:
        world, weights = self._pose(time)
        for draw, primitive in primitives:
            skinned = draw.skin is not None and primitive.joints is not None
            positions = morphed(primitive, weights.get(draw.node, draw.weights))
            at = draw.first
            for vertices, linear in _world_batches(positions, primitive, draw, world):
                yield PlacedPrimitive(draw.node, primitive, world[draw.node], skinned, vertices, at, linear)
                at += len(vertices)

    def instances(self) -> InstanceSet:
        world, weights = self._pose(0.0)
        meshes, mesh, matrices, starts = list[InstancedMesh](), list[int](), list[np.ndarray](), list[np.ndarray]()
        known, first = dict[int, int](), 0  # the list of primitives is the same at all nodes of a mesh
        for draw in self._draws:
            counts, n = np.array([p.triangles for p in draw.primitives], np.int64), draw.n_copies
            placed, deformed = _matrices(draw, world), _deformed(draw, weights, world)
            if draw.skin is not None and n > 1:
                raise InputError(f"{self.file}: has instances of a skinned mesh; load it with instances=False")
            if deformed is not None or id(draw.primitives) not in known:
                where = draw.primitives[0].where if draw.primitives else self.file
                parts = [p.mesh for p in draw.primitives] if deformed is None else deformed
                meshes.append(instanced_mesh(parts, where))
            if deformed is None:
                number = known.setdefault(id(draw.primitives), len(meshes) - 1)
            else:
                number, placed = len(meshes) - 1, placed if draw.skin is None else np.eye(4)[None]
            before = np.cumsum([0, *counts])[:-1]  # faces are ordered by primitive, then by copy
            starts += list(first + n * before + np.arange(n)[:, None] * counts)
            mesh += [number] * n
            matrices.append(placed)
            first += n * int(counts.sum())
        return instance_set(meshes, mesh, matrices, starts)

    def repeated_nodes(self) -> int:
        """The number of nodes with the mesh and the transform of another one, if nothing is animated."""
        world, single = self._pose(0.0)[0], [draw for draw in self._draws if draw.skin is None and draw.copies is None]
        keys = {(id(draw.parts), world[draw.node].tobytes()) for draw in single if draw.parts}
        return 0 if self._tracks else sum(bool(draw.parts) for draw in single) - len(keys)

    def cameras(self, time: float) -> list[Camera]:
        return self._views.cameras(self._pose(time)[0])

    def lights(self, time: float) -> list[Light]:
        return self._views.lights(self._pose(time)[0])

    def _pose(self, time: float) -> _Pose:
        """(world matrices of the nodes, (n, 4, 4); {node: animated morph weights})."""
        posed = self._posed
        if posed is None or posed[0] != time:
            self._posed = posed = time, self._new_pose(time)
        return posed[1]

    def _new_pose(self, time: float) -> _Pose:
        nodes, weights = self._nodes, dict[int, NDArray[np.float64]]()
        pose = {p: getattr(nodes, p).copy() for p in ("translation", "rotation", "scale")}
        for track in self._tracks:
            value = sample_track(track, time)
            if track.path == "weights":
                weights[track.node] = value
            else:
                pose[track.path][track.node] = value
        return world_matrices(nodes, posed_matrices(nodes, **pose)), weights


def read_gltf(path: Path, animation: str | None = None, streamed: bool = False) -> tuple[GltfSource, list[str]]:
    """(source, notes) for a .glb or .gltf file. The notes list everything left out.

    animation : name of the clip that plays; None: all play at once
    streamed : leave the faces of a large file on the disk
    """
    document = open_gltf(path, streamed)
    root, accessors, materials = document.root, Accessors(document), GltfMaterials(document)
    nodes = read_nodes(root)
    meshes = [_Mesh(fields, i) for i, fields in enumerate(root.objects("meshes"))]
    mesh_of_node = [f.whole("mesh", None, high=len(meshes)) for f in nodes.fields]
    draws = _mesh_nodes(document, accessors, materials, nodes, meshes, mesh_of_node)
    n_weights = [0 if m is None else meshes[m].n_targets for m in mesh_of_node]
    tracks, notes = read_tracks(root, accessors, nodes, n_weights, animation)
    views = GltfViews(root, nodes)
    _check_size(document.file, draws)
    _check_transforms(nodes, draws, tracks, views)
    source = GltfSource(document.file, *_info(meshes, mesh_of_node, nodes, draws), nodes, draws, tracks, views)
    source.animation = animation
    repeated = source.repeated_nodes()
    if repeated:
        notes.append(
            f"{document.file}: {counted(repeated, 'node', 'repeat')} another with the same mesh at the same place"
        )
    return source, notes + materials.notes + views.notes + ignored_fields(root)


class _Mesh:
    """A mesh of the file. Its primitives are read when a visible node uses it."""

    def __init__(self, fields: Fields, index: int):
        self.fields = fields
        self.name = fields.text("name", None) or f"mesh {index}"
        self.parts = fields.objects("primitives")
        counts = {len(p.objects("targets")) for p in self.parts}
        if len(counts) > 1:
            raise InputError(f"{fields.where} has primitives with different numbers of morph targets")
        self.n_targets = counts.pop() if counts else 0
        self._readers: list[PrimitiveReader] | None = None
        self._primitives: list[Primitive] | None = None
        self._skins: set[int] = set()  # indices of skins that passed `check_skin`

    @cached_property
    def runs(self) -> list[Primitive]:
        """The primitives that were read, with runs of small ones merged."""
        return join_small_primitives(self._primitives or [])

    def check_skin(self, index: int, skin: Skin) -> None:
        """Raise InputError if a primitive that was read uses joints that the skin lacks."""
        if index not in self._skins:
            for primitive in self._primitives or ():
                check_skin(primitive, skin)
            self._skins.add(index)

    def readers(self, accessors: Accessors, materials: GltfMaterials) -> list[PrimitiveReader]:
        """The primitives with triangles."""
        if self._readers is None:
            accessors.reserve_primitives(self.parts, self.fields.where)
            self._readers = [
                PrimitiveReader(part, triangles, self.name, accessors, materials, i)
                for i, part in enumerate(self.parts)
                if (triangles := triangles_of(part, accessors)) is not None
            ]
        return self._readers

    def primitives(self, accessors: Accessors, materials: GltfMaterials) -> list[Primitive]:
        if self._primitives is None:
            self._primitives = [reader.read() for reader in self.readers(accessors, materials)]
        return self._primitives

    def count(self) -> int:
        return sum(reader.triangles for reader in self._readers or ())


def _mesh_nodes(
    document: GltfDocument,
    accessors: Accessors,
    materials: GltfMaterials,
    nodes: Nodes,
    meshes: list[_Mesh],
    mesh_of_node: list[int | None],
) -> list[MeshNode]:
    skins, draws = read_skins(document.root, accessors, len(nodes.fields)), list[MeshNode]()
    visible = {index for node in np.flatnonzero(nodes.visible) if (index := mesh_of_node[node]) is not None}
    materials.decode_ahead(primitive for index in sorted(visible) for primitive in meshes[index].parts)
    for node in np.flatnonzero(nodes.visible).tolist():
        mesh_index = mesh_of_node[node]
        if mesh_index is None:
            continue
        fields, mesh = nodes.fields[node], meshes[mesh_index]
        is_read = document.scratch is None
        primitives = mesh.primitives(accessors, materials) if is_read else []
        on_disk = [] if is_read else mesh.readers(accessors, materials)
        index = fields.whole("skin", None, high=len(skins))
        skin = None if index is None else skins[index]
        if skin is not None:
            mesh.check_skin(index, skin)
        first = draws[-1].first + draws[-1].n_copies if draws else 0
        copies = _copies(fields, accessors)
        runs = mesh.runs if copies is None else primitives  # instancing orders faces by primitive, then copy
        draws.append(MeshNode(first, node, primitives, runs, _weights(fields, mesh), skin, copies, on_disk))
    return draws


def _weights(node: Fields, mesh: _Mesh) -> NDArray[np.float64]:
    """Morph weights at rest: from the node, else from the mesh, else zero."""
    for fields in (node, mesh.fields):
        weights: NDArray[np.float64] | None = fields.numbers("weights", None, None)
        if weights is not None and len(weights):
            if len(weights) != mesh.n_targets:
                raise fields.bad("weights", f"{counted(mesh.n_targets, 'number')}, one for each morph target")
            return weights
    return np.zeros(mesh.n_targets)


def _copies(node: Fields, accessors: Accessors) -> np.ndarray | None:
    """Transforms of EXT_mesh_gpu_instancing ((k, 4, 4) float64)."""
    extension = node.extension("EXT_mesh_gpu_instancing")
    if extension is None:
        return None
    attributes = extension.mapping("attributes", len(accessors))
    kinds = {"TRANSLATION": "VEC3", "ROTATION": "VEC4", "SCALE": "VEC3"}
    values = {k: accessors.finite(attributes[k], kind) for k, kind in kinds.items() if k in attributes}
    counts = {len(v) for v in values.values()}
    if len(counts) != 1:
        raise InputError(f"{extension.where} needs TRANSLATION, ROTATION or SCALE, all with the same count")
    (k,) = counts
    accessors.reserve(_COPY_BYTES * k, extension.where)
    rotation = values.get("ROTATION", np.broadcast_to((0.0, 0.0, 0.0, 1.0), (k, 4)))
    rotation = rotation / np.linalg.norm(rotation, axis=1, keepdims=True)
    copies = local_matrices(values.get("TRANSLATION", np.zeros((k, 3))), rotation, values.get("SCALE", np.ones((k, 3))))
    flat = np.flatnonzero(singular(copies))
    if len(flat):
        raise InputError(f"{extension.where} instance {flat[0]} has a transform without inverse; remove the instance")
    return copies


def _world_batches(
    positions: np.ndarray, primitive: Primitive, draw: MeshNode, world: np.ndarray
) -> Iterator[tuple[NDArray[np.float64], NDArray[np.float64] | None]]:
    """(world positions (k, v, 3) float64, `PlacedPrimitive.linear`) of a primitive, one batch of copies at a time."""
    if draw.skin is not None and primitive.joints is not None:
        yield skinned(positions, primitive, draw.skin, world), None
        return
    for vertices, matrices in copies_in_batches(positions, _matrices(draw, world)):
        yield vertices, matrices[:, :3, :3]


def _deformed(draw: MeshNode, weights: dict[int, np.ndarray], world: np.ndarray) -> list[Mesh] | None:
    """The deformed primitives of a draw: morphed in object space, or skinned in world space; None: they are rigid."""
    if draw.skin is None and all(primitive.targets is None for primitive in draw.primitives):
        return None
    out = []
    for primitive in draw.primitives:
        positions = morphed(primitive, weights.get(draw.node, draw.weights))
        if draw.skin is not None:
            positions = next(_world_batches(positions, primitive, draw, world))[0][0]
        out.append(primitive.mesh._replace(positions=positions))
    return out


def _matrices(draw: MeshNode, world: np.ndarray) -> NDArray[np.float64]:
    """(k, 4, 4) float64: the transforms of a draw's copies to world space."""
    out: NDArray[np.float64] = world[draw.node][None] if draw.copies is None else product(world[draw.node], draw.copies)
    return out


def _info(
    meshes: list[_Mesh], mesh_of_node: list[int | None], nodes: Nodes, draws: list[MeshNode]
) -> tuple[list[MeshInfo], list[ObjectInfo]]:
    """The visible meshes, and the objects: all copies at all nodes."""
    mesh_of_draw = [mesh for draw in draws if (mesh := mesh_of_node[draw.node]) is not None]  # that is, of each draw
    mesh_ids = sorted(set(mesh_of_draw))
    row, instances = {mesh: i for i, mesh in enumerate(mesh_ids)}, [0] * len(mesh_ids)
    names = _closest_names(nodes)
    objects: list[ObjectInfo] = []
    for draw, mesh_id in zip(draws, mesh_of_draw):
        mesh = row[mesh_id]
        name = _object_name(names, draw.node, meshes[mesh_id])
        for k in range(draw.n_copies):
            object_name = name if draw.copies is None else f"{name}[{k}]"
            objects.append(ObjectInfo(object_name, mesh, instances[mesh]))
            instances[mesh] += 1
    return [MeshInfo(meshes[m].name, meshes[m].count(), n) for m, n in zip(mesh_ids, instances)], objects


class _NodeName(NamedTuple):
    """The name of a node, and that of its closest ancestor with a name; None: there is none."""

    own: str | None
    inherited: str | None


def _closest_names(nodes: Nodes) -> list[_NodeName]:
    """The names of all nodes."""
    names = [_NodeName(None, None)] * len(nodes.fields)
    for node in (int(node) for level in nodes.levels for node in level):
        above = names[nodes.parent[node]] if nodes.parent[node] >= 0 else _NodeName(None, None)
        names[node] = _NodeName(nodes.fields[node].text("name", None) or None, above.own or above.inherited)
    return names


def _object_name(names: list[_NodeName], node: int, mesh: _Mesh) -> str:
    """The name of a node, else of its mesh, else of its closest ancestor with a name.

    gltfpack moves meshes to children without names, whose scale undoes the quantization.
    """
    own, inherited = names[node]
    return own or mesh.fields.text("name", None) or inherited or mesh.name


def _check_size(file: str, draws: list[MeshNode]) -> None:
    total = sum(p.triangles * d.n_copies for d in draws for p in d.parts)
    if total > MAX_TRIANGLES:
        raise InputError(f"{file}: {counted(total, 'triangle')} with all instances; at most {MAX_TRIANGLES} fit")


def _check_transforms(nodes: Nodes, draws: list[MeshNode], tracks: list[Track], views: GltfViews) -> None:
    """Check that transforms of meshes, cameras and lights are invertible at rest, unless their scale is animated."""
    used = np.zeros(len(nodes.fields), bool)
    for draw in draws:
        used[draw.node] = draw.skin is None
        if draw.skin is not None:
            used[draw.skin.joints] = True
    used[views.holders()] = True
    needed = with_ancestors(nodes, used)
    needed[[t.node for t in tracks if t.path == "scale"]] = False
    check_invertible(nodes, needed)
