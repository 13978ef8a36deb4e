"""A scene: triangles, cameras and lights as a function of time."""

from contextlib import suppress
from functools import cached_property

import numpy as np

from ..checks import as_array, choice, instance, items, quoted, text
from ..errors import InputError, one_line
from . import engine
from .any_scene import AnyScene
from .appearance import Appearance, appearance_of
from .camera import Camera
from .cityjson.model import CityModel
from .crs import checked_crs
from .cutouts import Cutouts, cutouts_of
from .materials import OPAQUE, PLAIN, Material
from .mesh import make_mesh
from .painted import painted, picture_texture
from .recentre import frame_origin
from .sampled import detail, moving_faces, sampled_faces, within
from .source import Source, StaticMeshes
from .survey import Survey, faces_of, objects_of
from .triangles import Triangles
from .view import View

_MOMENTS = 25  # of an animation, at which its lowest point is looked for


class Scene(AnyScene):
    """Triangles, cameras and lights in world space, at any time between 0 and `duration`.

    Made by `antumbra.load`, `antumbra.procedural`, `Scene.from_arrays` or `Scene.from_mesh`. Coordinates are
    evaluated in float64, recentred, and only then rounded to float32: world position = vertex + `origin`.

    The origin belongs to the scene and is the same at every time. It is about the middle of the scene. On each axis it
    is ``lower + round(((upper - lower) / 2) / g) * g`` in float64. The bounds are those at time 0, and ``g`` is
    ``2**(floor(log2(widest extent)) - 20)``. So a move of the whole scene leaves the bits of the float32 vertices the
    same, if float64 adds its offset exactly (such as a map grid's 5e6 m).

    Attributes
    ----------
    name : str
    up : "y" or "z"
        The axis that points up; `default_camera` and `default_light` use it, coordinates are not changed.
    duration : float
        Length of the animation in seconds; 0.0 for a static scene.
    n_triangles : int
    bounds : (2, 3) float64, world
        Lowest and highest corner at time 0.
    origin : (3,) float64, world
        Zero of the frame of the triangles.
    colours : (n, 3) float32
        Mean linear base colour of each face, in [0, 1]. Shared with the `Triangles`: do not write to it.
    meshes : list of MeshInfo
        Name, triangles and instances of each mesh.
    objects : list of ObjectInfo
        Name, mesh and instance of each object. Each node or instance of the file that shows a mesh is an object, in
        the order of its faces; of an OBJ file each material; of a CityJSON file each city object with faces, with its
        type and the object that it is a part of. Arrays and procedural scenes are one object.
    notes : tuple of str
        Features of the file that the loader omitted or approximated.
    source : Source
        Supplies the triangles, cameras and lights.
    crs : str or None
        The coordinate reference system of the world coordinates, such as "EPSG:7415": that of the file, or the `crs`
        that was given. Tables and rasters made from the scene carry it. Coordinates are easting and northing along the
        scene's own east and north axes: +X and +Y if Z is up, +X and -Z if Y is up.
    city : CityModel or None
        Of a CityJSON file: the object and the semantic surface of each face, and `CityModel.surface_types`.
    """

    def __init__(
        self,
        source: Source,
        *,
        name: str = "scene",
        up: str = "y",
        notes: tuple[str, ...] = (),
        city: CityModel | None = None,
        crs: str | None = None,
    ):
        if not all(hasattr(source, part) for part in ("pieces", "cameras", "lights")):
            raise InputError(f"source is {quoted(source)}; make a Scene by load, Scene.from_arrays or Scene.from_mesh")
        self.city = None if city is None else instance(city, CityModel, "city")
        self.name, self.up = one_line(text(name, "name")), checked_up(up)
        self.notes = tuple(one_line(note) for note in items(notes, str, "notes"))
        self.crs = None if crs is None else text(crs, "crs")
        self.source, self.meshes, self.duration = source, source.meshes, float(source.duration)
        self.objects = source.objects
        self._object_of_face: np.ndarray | None = None
        self.bounds, self.colours, self._looks, alpha = _survey(source)
        self._appearance: Appearance | None = None
        self._cutouts: Cutouts | None = None
        self._find_cutouts = alpha
        self.origin = frame_origin(*self.bounds)
        self._cameras, self._lights = source.cameras(0.0), source.lights(0.0)

    @classmethod
    def from_arrays(
        cls, vertices, faces=None, colours=None, *, vertex_colours=None, uv=None, texture=None, normals=None,
        name="arrays", up="y", crs=None,
    ) -> "Scene":  # fmt: skip
        """A static scene from arrays.

        Parameters
        ----------
        vertices : (v, 3) float, world
            Or an (n, 3, 3) soup of triangles, with `faces` None. Any float or integer dtype.
        faces : (f, 3) int, optional
            Indices of vertices. None: three vertices in a row are a face.
        colours : (3,) or (f, 3), optional
            Base colour of the scene or of each face; white by default. Floats are linear light in [0, 1], uint8 is
            sRGB. A fourth number, alpha, is dropped.
        vertex_colours : (v, 3), optional
            Colour of each vertex instead; pictures interpolate them, and `colours` has the mean of a face. Of a soup,
            of each of its 3 n corners.
        uv : (v, 2) float, optional
            Texture coordinates of each vertex: (0, 0) is the upper left corner of the texture, (1, 1) its lower right
            one. The texture repeats beyond. Of a soup, of each of its 3 n corners.
        texture : (h, w, 3) or (h, w, 4) uint8, optional
            A picture in sRGB, for `uv`. Vertex colours are multiplied with it.
        normals : (v, 3) float, optional
            Normals of each vertex, for shading only.
        name : str
            Name of the scene, also in errors.
        up : "y" or "z"
            The axis that points up.
        crs : str, optional
            The coordinate reference system of the vertices, see `Scene.crs`.

        Returns
        -------
        Scene

        Raises
        ------
        InputError
            If shapes or dtypes are wrong, vertices are NaN or infinite, indices are out of range, or there are no
            triangles.
        """
        positions, indices = _as_positions(vertices, text(name, "name")), None
        if faces is not None:
            if positions.ndim == 3:
                raise InputError(f"{name}: vertices are a triangle soup (n, 3, 3); leave faces out")
            indices = as_array(faces, f"{name}: faces")
        elif positions.shape[:-1] and positions.reshape(-1, 3).shape[0] % 3:
            raise InputError(f"{name}: {len(positions)} vertices are no multiple of 3; give faces")
        positions = positions.reshape(-1, 3)
        mesh = make_mesh(name, positions, indices, colours, name)
        if any(given is not None for given in (vertex_colours, uv, texture, normals)):
            if colours is not None:
                raise InputError(
                    f"{name}: colours and vertex_colours, uv, texture or normals exclude each other; leave colours out"
                )
            material = PLAIN if texture is None else Material(texture=picture_texture(texture, name))
            mesh = painted(mesh, indices, len(positions), material, name, uv, vertex_colours, normals)
        return cls(StaticMeshes([mesh], name), name=name, up=up, crs=None if crs is None else checked_crs(crs))

    @classmethod
    def from_mesh(cls, mesh, *, name: str | None = None, up="y", crs=None) -> "Scene":
        """A static scene from a mesh of another library. `antumbra.load` takes such meshes too.

        Parameters
        ----------
        mesh : object
            A trimesh ``Trimesh`` or ``Scene``, a pyvista data set (``PolyData``, or one that has a surface) or
            ``MultiBlock``, a meshio ``Mesh``, or an Open3D ``TriangleMesh`` of either kind. Colours of vertices and
            faces, and materials with textures of trimesh, are kept. Each node of a trimesh ``Scene`` is an object.
        name : str, optional
            Name of the scene, also in errors; None: the kind of mesh.
        up : "y" or "z"
            The axis that points up.
        crs : str, optional
            The coordinate reference system of the vertices, see `Scene.crs`.

        Returns
        -------
        Scene
            Its `notes` name what was left out.

        Raises
        ------
        InputError
            If the object is of another kind, has no triangles, or has vertices that are NaN or infinite.
        """
        from .foreign import meshes_of

        name = type(mesh).__name__.lower() if name is None else text(name, "name")
        meshes, notes = meshes_of(mesh, name)
        crs = None if crs is None else checked_crs(crs)
        return cls(StaticMeshes(meshes, name), name=name, up=up, notes=tuple(notes), crs=crs)

    @property
    def n_triangles(self) -> int:
        return len(self.colours)

    def _find_view(self) -> View:
        faces = moving_faces(self.source, self.n_triangles)
        box = detail(faces)
        view = View(within(faces, box), self.up, None)
        room = engine.answer("room_of", self, view.camera(1, 1), box)
        return view._replace(room=room, points=view.points if room is None or room.points is None else room.points)

    def _view_at(self, time: float) -> View:
        if not self.animated or self.view.room is not None:
            return self.view
        faces = sampled_faces(self.source, self.n_triangles, time)
        return self.view._replace(points=within(faces, detail(faces)))

    def _lowest(self, time: float | None) -> float:
        if not self.animated:
            return super()._lowest(time)
        if time is None:
            return self._lowest_ever
        axis = "xyz".index(self.up)
        return float(self.triangles(time).vertices[..., axis].min() + self.origin[axis])

    @cached_property
    def _lowest_ever(self) -> float:
        found = [self._lowest(0.0)]
        for time in np.linspace(0.0, self.duration, _MOMENTS)[1:]:
            with suppress(InputError):  # a moment that has no triangles shows its error when it is rendered
                found.append(self._lowest(time))
        return min(found)

    @property
    def object_of_face(self) -> np.ndarray:
        """(n,) int32: the index in `objects` of each face, in the order of `triangles`. Do not write to it.

        The first use evaluates the geometry once more, piece by piece.
        """
        if self._object_of_face is None:
            self._object_of_face = objects_of(self.source.pieces(0.0))
        return self._object_of_face

    @property
    def appearance(self) -> Appearance | None:
        """Textures, colours of vertices, shading normals and alpha; None if each face has one colour and no more.

        The first use evaluates the geometry once more, piece by piece. Textures are decoded when they are shown.
        """
        if self._looks and self._appearance is None:
            self._appearance = appearance_of(self.source, self.n_triangles)
        return self._appearance

    @property
    def cutouts(self) -> Cutouts | None:
        """The faces with holes, which alpha cuts; None: all faces are solid. The first use decodes their textures.

        Raises
        ------
        InputError
            If a texture cannot be decoded.
        """
        if self._find_cutouts:
            assert self.appearance is not None
            self._cutouts, self._find_cutouts = cutouts_of(self.appearance), False
        return self._cutouts

    def ignore_alpha(self) -> None:
        """Make all faces solid. Call it before the first query."""
        self._cutouts, self._find_cutouts = None, False

    def triangles(self, time: float = 0.0, threads: int | None = None) -> Triangles:
        """The triangles at `time` (seconds, clamped to 0 .. `duration`), recentred, always in the same order.

        threads : int, optional
            None: all cores.

        Raises
        ------
        InputError
            If the time is not a number, or the animation moves vertices to infinity.
        """
        from ..kernels.parallel import thread_count  # imports Numba, which file inspection does not need
        from .areas import solid_faces
        from .gather import gather

        time, threads = self.clamped(time), thread_count(threads)
        vertices = np.empty((self.n_triangles, 3, 3), np.float32)
        start = 0
        with np.errstate(all="ignore"):
            for piece in self.source.pieces(time):
                start += gather(piece, self.origin, vertices[start:], threads)
        face_id, cutouts = np.arange(self.n_triangles, dtype=np.int32), self.cutouts
        solid = solid_faces(vertices, None if cutouts is None else cutouts.solid, threads)
        return Triangles(vertices, self.origin.copy(), face_id, self.colours, cutouts, solid)

    def _cameras_at(self, time: float) -> list[Camera]:
        return self.source.cameras(time)

    def _lights_at(self, time: float) -> list:
        return self.source.lights(time)

    def __repr__(self) -> str:
        moving = f", duration={self.duration:g}" if self.animated else ""
        return f"Scene({self.name!r}, {self.n_triangles} triangles{moving}, up={self.up!r})"


def checked_up(up: str) -> str:
    return choice(up, "up", ("y", "z"))


def _survey(source: Source) -> tuple[np.ndarray, np.ndarray, bool, bool]:
    """Bounds ((2, 3) float64) and colours ((n, 3) float32) at time 0; whether any mesh has a look, and alpha."""
    survey, colours, looks, alpha = Survey(source.file), [np.empty((0, 3), np.float32)], False, False
    for piece in source.pieces(0.0):
        survey.add(piece)
        looks = looks or piece.look is not None
        alpha = alpha or (piece.look is not None and any(m.alpha_mode != OPAQUE for m in piece.look.materials))
        shape = piece.vertices.shape[0], faces_of(piece), 3
        colours.append(np.broadcast_to(piece.colour, shape).reshape(-1, 3))
    return survey.bounds(), np.concatenate(colours), looks, alpha


def _as_positions(vertices, name: str) -> np.ndarray:
    """`vertices` as (v, 3) or (n, 3, 3) floating point: float32 where that holds them, else float64."""
    positions = as_array(vertices, f"{name}: vertices")
    if positions.shape[-1:] != (3,) or positions.ndim not in (2, 3):
        raise InputError(
            f"{name}: vertices must be numbers, (v, 3) or (n, 3, 3), not {positions.dtype} {positions.shape}"
        )
    if positions.ndim == 3 and positions.shape[1] != 3:
        raise InputError(f"{name}: a triangle soup has shape (n, 3, 3), not {positions.shape}")
    return positions.astype(np.float32 if positions.dtype in (np.float16, np.float32) else np.float64)
