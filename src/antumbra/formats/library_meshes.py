"""Scenes from arrays, and from meshes of trimesh, PyVista, meshio and Open3D, without importing these libraries.

Mesh objects are recognised by their attributes, so any version of a library works, as do look-alike objects.
"""

import warnings
from collections.abc import Callable, Iterator
from types import ModuleType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import as_array, text
from ..base.errors import InputError
from ..base.wording import counted
from ..kernels.small_matrices import product
from ..scene.crs import checked_crs
from ..scene.materials import BLEND, MASK, OPAQUE, PLAIN, Material, PbrParameters, Texture, TextureMap, rgba_of
from ..scene.mesh import (
    Mesh,
    StaticMeshes,
    VertexAttributes,
    flip_v,
    linear_colours,
    make_mesh,
    picture_texture,
    textured_mesh,
)
from ..scene.rounded_coordinates import rounding_notes
from ..scene.scene_bounds import guess_y_up, sampled_faces
from ..scene.scene_data import MemoryData
from ..scene.units import LengthUnit, unit_named

KNOWN = "a mesh of trimesh, pyvista, meshio or Open3D"
_COLOUR_NAMES = "RGBA", "RGB", "rgba", "rgb", "colors", "Colors", "colours"
_CORNERS = {"triangle": 3, "quad": 4}  # of meshio's cells; higher-order cells list their corners first
MESH_UP = "z"
"""The up axis of meshes of other libraries, which have none of their own: their pictures and examples have z up."""

_FLAT = "vertex", "line"  # cells that block no light


class ForeignMesh(NamedTuple):
    """One mesh in the representation of its library."""

    name: str
    vertices: Any  # (v, 3) numbers, world
    faces: Any  # (f, 3) whole numbers
    colours: Any = None  # of the mesh or per face, as for `Scene.from_arrays`
    vertex_colours: Any = None  # per vertex
    material: Material = PLAIN
    uv: Any = None  # (v, 2) numbers: texture coordinates, v down
    normals: Any = None  # (v, 3) numbers: of the vertices


_Reader = Callable[[Any, str, list[str]], Iterator[ForeignMesh]]
"""(object, name, notes) -> its meshes."""


def is_mesh(obj: object) -> bool:
    """Whether `meshes_of` supports this kind of object."""
    return _reader(obj) is not None


def meshes_of(obj: object, name: str) -> tuple[list[Mesh], list[str]]:
    """The checked meshes of an object, and notes on anything left out.

    Raises
    ------
    InputError
        If the kind of object is unknown, or it has no triangles.
    """
    read = _reader(obj)
    if read is None:
        raise InputError(f"{name}: {type(obj).__module__}.{type(obj).__name__} is not {KNOWN}; give one of these")
    notes: list[str] = []
    try:
        foreign = [each for each in read(obj, name, notes) if len(each.faces)]
    except InputError:
        raise
    except Exception as error:  # a look-alike that is no mesh, or a damaged mesh
        reason = str(error)[:200] or type(error).__name__
        raise InputError(f"{name}: the {type(obj).__name__} cannot be read ({reason}); give {KNOWN}") from error
    if not foreign:
        raise InputError(f"{name}: the {type(obj).__name__} has no triangles{''.join(f'; {n}' for n in notes)}")
    return [_mesh(each, f'{name}: mesh "{each.name}"') for each in foreign], notes


def _mesh(foreign: ForeignMesh, where: str) -> Mesh:
    vertices, faces = as_array(foreign.vertices, f"{where}: vertices"), as_array(foreign.faces, f"{where}: faces")
    if vertices.ndim != 2 or vertices.shape[1] != 3:
        raise InputError(f"{where}: vertices must be numbers (v, 3), not {vertices.dtype} {vertices.shape}")
    precision = np.float32 if vertices.dtype in (np.float16, np.float32) else np.float64
    colours = None if foreign.colours is None else linear_colours(foreign.colours, where)
    mesh = make_mesh(foreign.name, vertices.astype(precision), faces, colours, where)
    material = foreign.material if foreign.colours is None else None
    attributes = VertexAttributes(foreign.uv, foreign.vertex_colours, foreign.normals)
    return textured_mesh(mesh, faces, len(vertices), material, where, attributes)


def _reader(obj: object) -> _Reader | None:
    if isinstance(obj, (type, ModuleType)):  # a class or module passed instead of a mesh
        return None

    def has(*names: str) -> bool:
        return all(hasattr(obj, name) for name in names)

    if has("geometry", "graph"):
        return _trimesh_scene
    if has("vertices", "faces", "visual"):
        return _trimesh
    if has("vertices", "triangles", "has_vertex_colors"):
        return _open3d
    if has("vertex", "triangle", "to_legacy"):
        return _open3d_tensors
    if has("point_data", "cell_data", "extract_surface"):
        return _pyvista
    if has("points", "cells", "cells_dict"):
        return _meshio
    if has("is_all_polydata", "keys"):
        return _pyvista_blocks
    return None


# --- trimesh -----------------------------------------------------------------------------------------------------


def _trimesh_scene(scene: Any, name: str, notes: list[str]) -> Iterator[ForeignMesh]:
    """The mesh of each scene-graph node, transformed to world space."""
    textures = _Textures()
    for node in scene.graph.nodes_geometry:
        matrix, geometry = scene.graph[node]
        part = scene.geometry[geometry]
        if not hasattr(part, "faces"):
            notes.append(f"{name}: {geometry!r} is a {type(part).__name__} and was left out")
            continue
        matrix = np.asarray(matrix, np.float64)
        (mesh,) = _trimesh(part, str(node), notes, textures)
        yield mesh._replace(vertices=product(mesh.vertices, matrix[:3, :3].T) + matrix[:3, 3])


def _trimesh(mesh: Any, name: str, notes: list[str], textures: "_Textures | None" = None) -> Iterator[ForeignMesh]:
    visual, foreign = mesh.visual, ForeignMesh(name, mesh.vertices, mesh.faces)
    kind = getattr(visual, "kind", None)
    if kind == "vertex":
        yield foreign._replace(vertex_colours=visual.vertex_colors)
    elif kind == "face":
        yield foreign._replace(colours=visual.face_colors)
    else:
        uv = flip_v(getattr(visual, "uv", None), len(mesh.vertices))
        yield foreign._replace(
            material=_material(getattr(visual, "material", None), name, {} if textures is None else textures), uv=uv
        )


_Textures = dict[tuple[int, bool, bool], Texture]
"""Those of pictures that several meshes of a scene share: id, whether its alpha matters, and whether it holds data."""


class _TrimeshMaterial:
    """A trimesh material, whose attributes of one meaning have several names, or are None."""

    def __init__(self, material: Any, name: str, textures: _Textures):
        self._material, self._name, self._textures = material, name, textures

    def first_of(self, *names: str) -> Any:
        """The first attribute that is given; None without one."""
        return next((v for n in names if (v := getattr(self._material, n, None)) is not None), None)

    def number(self, name: str, default: float) -> float:
        given = self.first_of(name)
        return default if given is None else float(given)

    def factor(self, *names: str, default: float) -> NDArray[np.float64]:
        """Linear shares: floats as they are, and bytes divided by 255."""
        given = self.first_of(*names)
        values = np.full(3, default) if given is None else np.asarray(given)
        return np.clip(values / 255.0 if values.dtype.kind in "iu" else values, 0.0, 1.0)

    def texture(self, *names: str, has_alpha: bool = False, holds_data: bool = False) -> Texture | None:
        """The texture of a picture, which is sRGB unless it holds data."""
        if (picture := self.first_of(*names)) is None:
            return None
        make = lambda: Texture(self._name, rgba_of(picture), has_alpha=has_alpha, holds_data=holds_data)
        key = id(picture), has_alpha, holds_data
        return self._textures.get(key) or self._textures.setdefault(key, make())

    def pbr(self) -> PbrParameters | None:
        """The metallic-roughness parameters of a PBRMaterial, with the defaults of glTF; None if it is diffuse."""
        if not hasattr(self._material, "metallicFactor"):
            return None

        def mapped(name: str, holds_data: bool = True) -> TextureMap | None:
            texture = self.texture(name, holds_data=holds_data)
            return None if texture is None else TextureMap(texture)

        r, g, b = self.factor("emissiveFactor", default=0.0)[:3].tolist()
        parameters = PbrParameters(
            metallic=min(max(self.number("metallicFactor", 1.0), 0.0), 1.0),
            roughness=min(max(self.number("roughnessFactor", 1.0), 0.0), 1.0),
            metal_map=mapped("metallicRoughnessTexture"),
            occlusion_map=mapped("occlusionTexture"),
            normal_map=mapped("normalTexture"),
            emission=(r, g, b),
            emission_map=mapped("emissiveTexture", False) if any((r, g, b)) else None,
        )
        return None if parameters.is_plain else parameters


def _material(material: Any, name: str, textures: _Textures) -> Material:
    """A trimesh material. Its factors are linear, its image is sRGB."""
    given = _TrimeshMaterial(material, name, textures)
    mode = given.first_of("alphaMode")
    mode = mode if mode in (MASK, BLEND) else OPAQUE
    r, g, b, a = np.append(given.factor("baseColorFactor", "diffuse", default=1.0), 1.0)[:4].tolist()
    texture = given.texture("baseColorTexture", "image", has_alpha=mode != OPAQUE)
    return Material(name, (r, g, b, a), texture, mode, given.number("alphaCutoff", 0.5), pbr=given.pbr())


# --- Open3D ------------------------------------------------------------------------------------------------------


def _open3d(mesh: Any, name: str, notes: list[str]) -> Iterator[ForeignMesh]:
    colours = _from_srgb(mesh.vertex_colors) if mesh.has_vertex_colors() else None
    has_normals = getattr(mesh, "has_vertex_normals", lambda: False)()
    normals = np.asarray(mesh.vertex_normals) if has_normals else None
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
    yield ForeignMesh(name, vertices, faces, vertex_colours=colours, normals=normals)


def _open3d_tensors(mesh: Any, name: str, notes: list[str]) -> Iterator[ForeignMesh]:
    yield from _open3d(mesh.to_legacy(), name, notes)


def _from_srgb(colours: ArrayLike) -> NDArray[np.uint8]:
    """(v, 3) uint8 sRGB from Open3D colours in [0, 1], which Open3D displays unconverted; most came from bytes."""
    return np.rint(np.clip(np.asarray(colours, np.float64), 0.0, 1.0) * 255.0).astype(np.uint8)


# --- pyvista -----------------------------------------------------------------------------------------------------


def _pyvista(data: Any, name: str, notes: list[str]) -> Iterator[ForeignMesh]:
    """A PolyData, or the surface of another data set. PyVista triangulates polygons."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # PyVista warns about its own defaults
        surface = (data if hasattr(data, "strips") else data.extract_surface()).triangulate()
    faces = np.asarray(surface.faces).reshape(-1, 4)[:, 1:]
    of_faces = _named_colours(surface.cell_data) if len(faces) == surface.n_cells else None
    of_points, normals = _named_colours(surface.point_data), _point_normals(surface.point_data)
    of_faces = None if of_points is not None else of_faces
    yield ForeignMesh(name, surface.points, faces, of_faces, of_points, normals=normals)


def _point_normals(data: Any) -> np.ndarray | None:
    """(v, 3) float: the array that VTK names Normals; None without it."""
    normals = np.asarray(data["Normals"]) if "Normals" in list(data) else None
    return normals if normals is not None and normals.dtype.kind == "f" and normals.shape[1:] == (3,) else None


def _pyvista_blocks(blocks: Any, name: str, notes: list[str]) -> Iterator[ForeignMesh]:
    for i, key in enumerate(blocks.keys()):
        block = blocks[i]
        read = None if block is None else _reader(block)
        if read is not None:
            yield from read(block, str(key), notes)


def _named_colours(data: Any) -> np.ndarray | None:
    """An (n, 3) or (n, 4) uint8 array with a conventional name, else the only such array; None if there is none."""
    bytes_of = {
        name: values
        for name in data
        if (values := np.asarray(data[name])).dtype == np.uint8 and values.ndim == 2 and values.shape[1] in (3, 4)
    }
    named = [bytes_of[name] for name in _COLOUR_NAMES if name in bytes_of]
    usable = named or list(bytes_of.values())
    return usable[0] if named or len(usable) == 1 else None


# --- meshio ------------------------------------------------------------------------------------------------------


def _meshio(mesh: Any, name: str, notes: list[str]) -> Iterator[ForeignMesh]:
    """Triangles and quads. Higher-order cells become flat between their corners; volume cells are left out."""
    points, faces = np.asarray(mesh.points), list[np.ndarray]()
    if points.ndim == 2 and points.shape[1] == 2:
        points = np.column_stack([points, np.zeros(len(points))])
    for block in mesh.cells:
        kind = block.type.rstrip("0123456789")
        if kind in _CORNERS:
            corners = np.asarray(block.data)[:, : _CORNERS[kind]]
            faces.append(corners[:, :3])
            if kind == "quad":
                faces.append(corners[:, [0, 2, 3]])
        elif kind not in _FLAT:
            notes.append(
                f"{name}: left out {counted(len(block.data), 'cell')} of kind {block.type!r}; "
                "pyvista.from_meshio(mesh).extract_surface() has their surface"
            )
    if not faces:
        return
    yield ForeignMesh(name, points, np.concatenate(faces), vertex_colours=_named_colours(mesh.point_data))


# --- Scenes from arrays and library meshes ----------------------------------------------------------------------------


def data_of_arrays(
    vertices: object,
    faces: object = None,
    colours: object = None,
    *,
    vertex_colours: object = None,
    uv: object = None,
    texture: object = None,
    normals: object = None,
    name: str = "arrays",
    up: str = "y",
    crs: object = None,
    unit: str | LengthUnit | None = None,
) -> MemoryData:
    """Scene data from arrays; `Scene.from_arrays` documents the arguments."""
    positions, indices = positions_of(vertices, text(name, "name")), None
    if faces is not None:
        if positions.ndim == 3:
            raise InputError(f"{name}: vertices are a triangle soup (n, 3, 3); leave faces out")
        indices = as_array(faces, f"{name}: faces")
    elif positions.shape[:-1] and positions.reshape(-1, 3).shape[0] % 3:
        raise InputError(f"{name}: {counted(len(positions), 'vertex', 'are')} not a multiple of 3; give faces")
    positions = positions.reshape(-1, 3)
    mesh = make_mesh(name, positions, indices, colours, name)
    if any(attribute is not None for attribute in (vertex_colours, uv, texture, normals)):
        if colours is not None and any(each is not None for each in (vertex_colours, uv, texture)):
            raise InputError(f"{name}: colours and vertex_colours, uv or texture exclude each other; leave colours out")
        textured = None if texture is None else Material(texture=picture_texture(texture, name))
        material = None if colours is not None else textured or PLAIN
        attributes = VertexAttributes(uv, vertex_colours, normals)
        mesh = textured_mesh(mesh, indices, len(positions), material, name, attributes)
    system = None if crs is None else checked_crs(crs)
    return MemoryData(StaticMeshes([mesh], name), name=name, up=up, crs=system, unit=unit)


def data_of_mesh(
    mesh: object,
    *,
    name: str | None = None,
    up: str | None = None,
    crs: object = None,
    unit: str | LengthUnit | None = None,
) -> MemoryData:
    """Scene data from a mesh; `Scene.from_mesh` documents the arguments."""
    name = type(mesh).__name__.lower() if name is None else text(name, "name")
    meshes, notes = meshes_of(mesh, name)
    crs = None if crs is None else checked_crs(crs)
    own = getattr(mesh, "units", None)  # of trimesh
    if unit is None and crs is None and isinstance(own, str):
        unit = unit_named(own)
    axis = MESH_UP if up is None else up
    data = MemoryData(StaticMeshes(meshes, name), name=name, up=axis, notes=tuple(notes), crs=crs, unit=unit)
    rounded = rounding_notes(name, data.bounds, lambda: sampled_faces(data.source, data.n_triangles))
    data.notes = (*data.notes, *rounded)
    if up is None and guess_y_up(sampled_faces(data.source, data.n_triangles)):
        data.notes = (*data.notes, f'{name}: seems to have y up, and is read as z up; pass up="y"')
    return data


def positions_of(vertices: object, name: str) -> np.ndarray:
    """`vertices` as (v, 3) or (n, 3, 3) floating point: float32 if lossless for their dtype, else float64."""
    positions = as_array(vertices, f"{name}: vertices")
    if positions.shape[-1:] != (3,) or positions.ndim not in (2, 3):
        raise InputError(
            f"{name}: vertices must be numbers, (v, 3) or (n, 3, 3), not {positions.dtype} {positions.shape}"
        )
    if positions.ndim == 3 and positions.shape[1] != 3:
        raise InputError(f"{name}: a triangle soup has shape (n, 3, 3), not {positions.shape}")
    return positions.astype(np.float32 if positions.dtype in (np.float16, np.float32) else np.float64)
