"""The public classes of scenes: data, an engine that answers queries, and default views.

`AnyScene` is the common interface. `Scene` holds its triangles in memory; `paged_scene.PagedScene` is its counterpart
for stores.
"""

import threading
from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any, Generic, Self, TypeVar, overload

import numpy as np
from numpy.typing import ArrayLike

from ..base import wings
from ..base.checks import choice, whole_number
from ..base.errors import InputError
from ..base.forks import free_lock, renew_after_fork
from ..base.wording import counted
from ..formats.instance_arrays import data_of_instances
from ..formats.library_meshes import data_of_arrays, data_of_mesh
from ..generate.generated_scene import procedural_data
from ..scene import camera as camera_module
from ..scene.alpha_masks import Cutouts
from ..scene.appearance import Appearance
from ..scene.camera import MAX_SIZE, Camera
from ..scene.default_picture import KINDS, DefaultView, missing_skies
from ..scene.instance_data import InstanceData
from ..scene.lights import Light, QuadLight
from ..scene.materials import Transmittance
from ..scene.mesh import MeshInfo, ObjectInfo, Source
from ..scene.raster import Raster
from ..scene.scene_data import CityModel, MemoryData, SceneData
from ..scene.triangles import Triangles
from ..scene.units import LengthUnit
from .ray_queries import RayQueries

# --- The interface of scenes ------------------------------------------------------------------------------------------


if TYPE_CHECKING:
    from ..scene.moved_geometry import ObjectChoice
    from .engine import Engine
    from .scene_views import SceneViews

_T = TypeVar("_T")


class DataAttribute(Generic[_T]):
    """An attribute of a scene that is stored in its data."""

    def __set_name__(self, owner: type, name: str) -> None:
        self._name = name

    @overload
    def __get__(self, scene: None, owner: type) -> "DataAttribute[_T]": ...
    @overload
    def __get__(self, scene: "AnyScene", owner: type) -> _T: ...
    def __get__(self, scene: "AnyScene | None", owner: type) -> Any:
        return self if scene is None else getattr(scene.data, self._name)

    def __set__(self, scene: "AnyScene", value: _T) -> None:
        setattr(scene.data, self._name, value)


class AnyScene(RayQueries):
    """A scene: its data, an engine that answers queries, and default views. `Scene` documents the attributes.

    data : SceneData
    """

    name = DataAttribute[str]()
    up = DataAttribute[str]()
    notes = DataAttribute[tuple[str, ...]]()
    duration = DataAttribute[float]()
    meshes = DataAttribute[list[MeshInfo]]()
    objects = DataAttribute[list[ObjectInfo]]()
    bounds = DataAttribute[np.ndarray]()
    origin = DataAttribute[np.ndarray]()
    middle = DataAttribute[np.ndarray]()
    colours = DataAttribute[np.ndarray]()
    city = DataAttribute[CityModel | None]()
    crs = DataAttribute[str | None]()
    unit = DataAttribute[LengthUnit]()
    raster = DataAttribute[Raster | None]()
    n_triangles = DataAttribute[int]()
    object_of_face = DataAttribute[np.ndarray]()
    appearance = DataAttribute[Appearance | None]()
    cutouts = DataAttribute[Cutouts | None]()
    animated = DataAttribute[bool]()
    cameras = DataAttribute[list[Camera]]()
    lights = DataAttribute[list[Light]]()

    def __init__(self, data: SceneData):
        self.data = data
        self._engine: Engine | None = None
        self._view: tuple[DefaultView, Triangles | None] | None = None  # with `data.moved` at that time
        self._lock = threading.Lock()
        renew_after_fork(self)

    @classmethod
    def of_data(cls, data: SceneData) -> Self:
        """A scene with the given data, such as the `data` of another scene."""
        scene = cls.__new__(cls)
        scene.__setstate__({"data": data})
        return scene

    def __getstate__(self) -> dict[str, Any]:
        return {"data": self.data}

    def __setstate__(self, state: dict[str, Any]) -> None:
        AnyScene.__init__(self, state["data"])

    def _after_fork(self) -> None:
        self._lock = free_lock(self._lock)

    @property
    def engine(self) -> "Engine":
        """Answers queries about this scene and caches trees between them."""
        engine = self._engine
        return self._new_engine() if engine is None else engine

    def _new_engine(self) -> "Engine":
        from .engine import Engine  # imports kernels, which file inspection does not need

        with self._lock:
            if self._engine is None:
                self._engine = Engine(self)
            return self._engine

    def camera(self, index: int = 0, time: float = 0.0) -> Camera:
        """A camera of the file, by its index, at a time in seconds."""
        return self.data.camera(index, time)

    def light(self, index: int = 0, time: float = 0.0) -> Light:
        """A light of the file, by its index, at a time in seconds."""
        return self.data.light(index, time)

    def triangles(self, time: float = 0.0, threads: int | None = None) -> Triangles:
        """The triangles at `time` (seconds, clamped to 0 .. `duration`), recentred, always in the same order.

        threads : int, optional
            None: all cores.

        Raises
        ------
        InputError
            If the time is not a number, the animation moves vertices to infinity, or a store does not fit in memory.
        """
        return self.data.triangles(time, threads)

    def ignore_alpha(self) -> None:
        """Make all faces solid. Call it before the first query."""
        self.data.ignore_alpha()

    def set_transmittance(self, shares: Mapping[str, Transmittance]) -> None:
        """Let a share of the light pass through materials or objects, such as panes or the crowns of plants.

        It counts in pictures, `visibility`, `sun_hours` and `bake`. Along a ray, the shares of all surfaces multiply;
        below 1/256 the light is blocked. Closest hits, cameras and `occluded` see a surface if it blocks at least half
        of the light. Call it before the first query.

        Trees are bare in winter: twelve shares are those of the months from January to December. `sun_hours` uses the
        month of each sun on the wall clock. Queries without a date, which are all others, use the mean of the months.

        Parameters
        ----------
        shares : dict of str to float, three floats, or twelve of these
            Names of materials or objects, in which * and ? stand for any characters, and the share of the light that
            passes, from 0 to 1, also of red, green and blue; or one of these per month. Holes of masks stay holes. The
            crowns of `from_trees` take the share of a whole crown, all other materials that of a surface.

        Raises
        ------
        InputError
            If a name matches nothing, a share is out of range, or there are neither one, three nor twelve.
        """
        self.data.set_transmittance(shares)

    def update(
        self,
        vertices: "ArrayLike | None" = None,
        *,
        objects: "ObjectChoice" = None,
        transform: "ArrayLike | None" = None,
        threads: int | None = None,
    ) -> None:
        """Move the geometry. Everything that reads the scene afterwards finds it at its new place.

        Faces, colours, textures, cut-outs and lights stay, and shading normals turn with their faces. The next query
        refits its tree, or rebuilds it once rays have lost as much time as that takes. Results have the bits of a new
        scene with the same triangles.

        Parameters
        ----------
        vertices : (n, 3, 3) or (v, 3) float, world
            New corners of all triangles; or new vertices, in the order of the arrays or the mesh from which the scene
            was made.
        objects : str, int, ObjectInfo, or a list of them
            The objects that a transform moves: names, in which * and ? stand for any characters, or indices or entries
            of `Scene.objects`. None: all.
        transform : (4, 4) float, or (k, 4, 4) for k objects
            Moves objects in world space: ``position = transform @ (x, y, z, 1)`` in float64, where (x, y, z) is the
            place at which the vertex was loaded, or at which `vertices` last put it. So transforms do not add up, and
            those of other objects stay in force. The last row is 0, 0, 0, 1.
        threads : int, optional
            None: all cores.

        Raises
        ------
        InputError
            If the scene is animated or in a store; a shape is wrong; a number is NaN, infinite, or more than 1e18 from
            `origin`; or no object has the name. The geometry is then unchanged.

        Notes
        -----
        `origin` does not change, so receivers and hits from before stay valid. As always, vertices are recentred in
        float64 and rounded to float32 once. If the whole scene moves away by thousands of its own widths, make a new
        scene, in whose frame float32 is finer.

        Python threads may query the scene meanwhile. Each query, and each frame, sees the geometry before or after the
        update, never a mix of both. A study, which makes many queries, should not run at the same time. Arrays that
        were returned before do not change.
        """
        self.engine.update(vertices, objects, transform, threads)

    def clamped(self, time: float) -> float:
        """A time in seconds, clamped to 0 .. `duration`. Raises InputError unless it is a number."""
        return self.data.clamped(time)

    def ground_height(self, time: float | None = None) -> float:
        """The height along the up axis, in world units, of a level ground just below the scene.

        Parameters
        ----------
        time : float or None
            Seconds; the scene at this time of an animation. None: the whole animation.
        """
        return self.data.ground_height(time)

    def default_camera(
        self, width: int = 1024, height: int = 1024, kind: str = "perspective", time: float | None = None
    ) -> Camera:
        """A three-quarter view from slightly above, as close as fits the whole scene.

        Outlying parts and a wide ground may lie outside the image. A scene that encloses a room is shown from inside.

        Parameters
        ----------
        width, height : int
            Pixels.
        kind : str
            "perspective"; "orthographic", from outside; "top", orthographic from above; or "panoramic", from the middle
            of a room.
        time : float or None
            Seconds; the view fits the scene at this time of an animation. None: the whole animation.
        """
        choice(kind, "camera kind", KINDS)
        width = whole_number(width, "picture width", 1, MAX_SIZE)
        height = whole_number(height, "picture height", 1, MAX_SIZE)
        from .default_view import view_at

        view = self.view if time is None else view_at(self.data, self.view, self.clamped(time))
        return view.camera(width, height) if kind == "perspective" else view.other_camera(kind, width, height)

    @property
    def view(self) -> DefaultView:
        """The geometry that a default view shows, computed on first use."""
        view, moved = self._view, self.data.moved
        if view is None or view[1] is not moved:
            from .default_view import view_of

            self._view = view = view_of(self.data, self._views), moved
        return view[0]

    def _views(self) -> "SceneViews":
        """Makes the images from which the default view follows."""
        from .scene_views import ViewsInMemory

        return ViewsInMemory(self.data.triangles(0.0))

    def default_lights(self, time: float = 0.0) -> list[Light]:
        """The lights of the file at a time, or daylight: a sun to the viewer's left, and a `Sky`.

        A closed room without lights gets a lamp instead of the sun. A sky is added to the file's lights if one of them
        is a sun.
        """
        time = self.clamped(time)
        file_lights = [self.light(i, time) for i in range(len(self.lights))]
        return file_lights + missing_skies(file_lights, self.up) if file_lights else self.view.lights()

    def default_light(self) -> QuadLight:
        """A single light: a `QuadLight` above the scene, as wide as the radius of its bounding sphere."""
        return camera_module.default_light(self.bounds, self.up)

    def page(
        self,
        path: Any = None,
        *,
        title: str | None = None,
        when: Any = None,
        place: Any = None,
        credits: str = "",
        language: str = "en",
        camera: Camera | None = None,
        time: float = 0.0,
    ) -> Any:
        """Make a page with exact shadows, which any browser opens offline, as ``antumbra page`` does.

        Parameters
        ----------
        path : str or path-like, optional
            An .html file. None: the page is only returned, for a notebook.
        title : str, optional
            None: the name of the scene.
        when : str, date or datetime, optional
            Day, or local day and time, of the first picture, such as "2026-06-21T15:30". None: today, 14:00.
        place : Place, optional
            None: the place of the CRS; without one, the sun is set by hand.
        credits : str
            Author and licence of the model, below the picture.
        language : str
            "en" or "de".
        camera : Camera, optional
            The first view, perspective. None: the default view.
        time : float
            Seconds into the animation. Pages do not move.

        Returns
        -------
        Page
            The text is its ``html``; notebooks show it in a frame.

        Raises
        ------
        InputError
            If the scene has more than 2 million triangles or holes, or lets light pass; if an argument is invalid, or
            the file cannot be written.
        """
        make = wings.named(wings.PAGE)
        keywords = {"title": title, "when": when, "place": place, "credits": credits, "language": language}
        return make(self, path, camera=camera, time=time, **keywords)

    def _repr_html_(self) -> str:
        """A summary table for notebooks."""
        size = " x ".join(f"{v:.4g}" for v in self.bounds[1] - self.bounds[0])
        rows = {
            "triangles": f"{self.n_triangles:,}",
            "objects": f"{len(self.objects):,}",
            "size": f"{size}, {self.up} up",
            **({"crs": self.crs} if self.crs else {}),
            **({} if self.data.given_unit is None else {"unit": self.data.given_unit.name}),
            "cameras, lights": f"{len(self.cameras)}, {len(self.lights)}",
            **({"duration": f"{self.duration:g} s"} if self.animated else {}),
            **({"left out": "; ".join(self.notes)} if self.notes else {}),
        }
        body = "".join(f"<tr><th>{name}</th><td>{escape(value)}</td></tr>" for name, value in rows.items())
        return f"<table><caption>{type(self).__name__} {escape(self.name)}</caption>{body}</table>"


# --- Scenes in memory -------------------------------------------------------------------------------------------------


class Scene(AnyScene):
    """Triangles, cameras and lights in world space, at any time between 0 and `duration`.

    Created by `antumbra.load`, `antumbra.procedural`, `Scene.from_arrays`, `Scene.from_instances` or
    `Scene.from_mesh`. Coordinates are evaluated in float64, recentred, and only then rounded to float32: world position
    = vertex + `origin`.

    The origin is a property of the scene, the same at all times. If float32 holds all coordinates of static meshes, as
    of most STL and PLY files, it is 0 on axes on which the scene lies within 16 times its widest extent, and otherwise
    the middle in float32. Nothing is rounded then: answers are those for the caller's own vertices, and for rays and
    points in float32. (On axes with another origin, their coordinates must lie between half and twice it.)

    For all other scenes, it is ``lower + round(((upper - lower) / 2) / g) * g`` in float64 on each axis, with the
    bounds at time 0 and ``g = 2**(floor(log2(widest extent)) - 20)``. Translating the whole scene then does not change
    the bits of the float32 vertices if float64 adds the offset exactly (such as the 5e6 m of a map grid).

    Attributes
    ----------
    name : str
    up : "y" or "z"
        The axis that points up. `default_camera` and `default_light` use it; coordinates are not changed.
    duration : float
        Length of the animation in seconds; 0.0 for a static scene.
    n_triangles : int
    bounds : (2, 3) float64, world
        Lower and upper corner at time 0.
    origin : (3,) float64, world
        Origin of the frame of the triangles.
    middle : (3,) float64, world
        Middle of the bounds when the scene was made. It is the origin, unless that is one that loses no bits.
    colours : (n, 3) float32
        Mean linear base colour of each face, in [0, 1]. Shared with the `Triangles`: do not write to it.
    meshes : list of MeshInfo
        Name, triangles and instances of each mesh.
    objects : list of ObjectInfo
        Name, mesh and instance of each object, in the order of their faces. An object is a node or instance of the file
        with a mesh; in an OBJ file, a material; in a CityJSON file, a city object with faces, with its type and parent
        object. Arrays and procedural scenes are one object.
    notes : tuple of str
        Features of the file that the loader omitted or approximated.
    source : Source
        Supplies the triangles, cameras and lights.
    crs : str or None
        The coordinate reference system of the world coordinates, such as "EPSG:7415": that of the file, or the `crs`
        argument. Tables and rasters made from the scene carry it. Coordinates are easting and northing along the
        scene's east and north axes: +X and +Y if Z is up, +X and -Z if Y is up.
    unit : LengthUnit
        The unit of the world coordinates: that of the CRS, or the `unit` argument, or metres. Lengths in results are in
        it; areas are in square metres, and energies in kWh. Instances, trees and all else in a scene share it.
    city : CityModel or None
        For a CityJSON file or footprints: the object and the semantic surface of each face, and
        `CityModel.surface_types`.
    raster : Raster or None
        For a raster of heights, and for scenes on one: its cells. The sensors ``raster`` lie in them, so that results
        come back on the input's own grid. None for other scenes, and for cells that are not square.
    """

    data: MemoryData | InstanceData
    source = DataAttribute[Source]()

    def __init__(
        self,
        source: Source,
        *,
        name: str = "scene",
        up: str = "y",
        notes: tuple[str, ...] = (),
        city: CityModel | None = None,
        crs: str | None = None,
        unit: str | None = None,
    ):
        super().__init__(MemoryData(source, name=name, up=up, notes=notes, city=city, crs=crs, unit=unit))

    @classmethod
    def from_arrays(
        cls,
        vertices: "ArrayLike",
        faces: "ArrayLike | None" = None,
        colours: "ArrayLike | None" = None,
        *,
        vertex_colours: "ArrayLike | None" = None,
        uv: "ArrayLike | None" = None,
        texture: "ArrayLike | None" = None,
        normals: "ArrayLike | None" = None,
        name: str = "arrays",
        up: str = "y",
        crs: str | None = None,
        unit: str | None = None,
    ) -> "Scene":
        """A static scene from arrays.

        Parameters
        ----------
        vertices : (v, 3) float, world
            Or an (n, 3, 3) soup of triangles, with `faces` None. Any float or integer dtype.
        faces : (f, 3) int, optional
            Indices of vertices. None: three consecutive vertices form a face.
        colours : (3,) or (f, 3), optional
            Base colour of the scene or of each face; white by default. Floats are linear light in [0, 1], uint8 is
            sRGB. A fourth number, alpha, is dropped.
        vertex_colours : (v, 3), optional
            Colour of each vertex, or of each of the 3 n corners of a soup, instead of `colours`. Images interpolate
            them, and `Scene.colours` has the mean of each face.
        uv : (v, 2) float, optional
            Texture coordinates of each vertex, or of each of the 3 n corners of a soup: (0, 0) is the upper left corner
            of the texture, (1, 1) the lower right one. The texture repeats.
        texture : (h, w, 3) or (h, w, 4) uint8, optional
            An sRGB image, for `uv`. It is multiplied by vertex colours.
        normals : (v, 3) float, optional
            Normal of each vertex, for shading and bakes; visibility does not depend on it.
        name : str
            Name of the scene, also in errors.
        up : "y" or "z"
            The axis that points up.
        crs : str, optional
            The coordinate reference system of the vertices, see `Scene.crs`.
        unit : str, optional
            The length unit of the vertices: "mm", "cm", "dm", "m", "km", "in", "ft" or "us-ft". None: that of the CRS,
            or metres. See `Scene.unit`.

        Returns
        -------
        Scene

        Raises
        ------
        InputError
            If shapes or dtypes are wrong, vertices are NaN or infinite, indices are out of range, or there are no
            triangles.

        Examples
        --------
        >>> roof = at.Scene.from_arrays([[0, 0, 1], [4, 0, 1], [0, 4, 1]], [[0, 1, 2]])
        >>> roof.n_triangles
        1
        """
        data = data_of_arrays(
            vertices,
            faces,
            colours,
            vertex_colours=vertex_colours,
            uv=uv,
            texture=texture,
            normals=normals,
            name=name,
            up=up,
            crs=crs,
            unit=unit,
        )
        return cls.of_data(data)

    @classmethod
    def from_mesh(
        cls,
        mesh: object,
        *,
        name: str | None = None,
        up: str | None = None,
        crs: str | None = None,
        unit: str | None = None,
    ) -> "Scene":
        """A static scene from a mesh of another library. `antumbra.load` accepts such meshes too.

        Parameters
        ----------
        mesh : object
            A `trimesh.Trimesh` or ``Scene``, a pyvista data set (`pyvista.PolyData`, or one that has a surface) or
            ``MultiBlock``, a meshio ``Mesh``, or an Open3D ``TriangleMesh`` of either kind. Vertex and face colours are
            kept, as are trimesh materials with textures. Each node of a trimesh ``Scene`` becomes an object, and its
            ``units`` those of the scene.
        name : str, optional
            Name of the scene, also in errors; None: the kind of mesh.
        up : "y" or "z", optional
            The axis that points up. None: z, as these libraries draw meshes, with a note if the floors and roofs of the
            mesh face y.
        crs : str, optional
            The coordinate reference system of the vertices, see `Scene.crs`.
        unit : str, optional
            The length unit of the vertices: "mm", "cm", "dm", "m", "km", "in", "ft" or "us-ft". None: that of the CRS,
            or metres. See `Scene.unit`.

        Returns
        -------
        Scene
            Its `notes` list the features that were omitted.

        Raises
        ------
        InputError
            If the object has another type, no triangles, or vertices that are NaN or infinite.
        """
        return cls.of_data(data_of_mesh(mesh, name=name, up=up, crs=crs, unit=unit))

    @classmethod
    def from_instances(
        cls,
        meshes: "Sequence[Any]",
        transforms: "Sequence[ArrayLike]",
        colours: "Sequence[ArrayLike | None] | None" = None,
        *,
        name: str = "instances",
        up: str = "y",
        crs: str | None = None,
        unit: str | None = None,
        instances: bool | None = None,
    ) -> "Scene":
        """A static scene of meshes with copies, such as a forest.

        Its triangles are those of the flattened scene: vertices are transformed in float64, recentred and rounded to
        float32. All answers are those of the flattened scene too, bit by bit, but instances only take memory for the
        meshes. Faces are ordered by mesh, then by copy, then as in the mesh; each copy is an object.

        Parameters
        ----------
        meshes : list of (vertices, faces) or (n, 3, 3) arrays
            Vertices (v, 3) of any float or integer dtype, in object space, and faces (f, 3) int; or a triangle soup.
        transforms : list of (k, 4, 4) or (k, 3, 4) float
            For each mesh, the object-to-world matrices of its copies, which act on column vectors. They may mirror,
            scale and shear.
        colours : list of None, (3,) or (f, 3), optional
            For each mesh, its base colour or those of its faces, as in `from_arrays`.
        name, up, crs, unit
            As in `from_arrays`.
        instances : bool, optional
            False: flatten the scene, so that every plan can trace it. None: flatten it if copies take less than 1 GiB.

        Raises
        ------
        InputError
            If shapes or dtypes are wrong, numbers are NaN or infinite, a transform has no inverse, or there are no
            triangles, or more than 2^31 - 1 with all copies.
        """
        return cls.of_data(
            data_of_instances(meshes, transforms, colours, name=name, up=up, crs=crs, unit=unit, instances=instances)
        )

    def __repr__(self) -> str:
        duration = f", duration={self.duration:g}" if self.animated else ""
        return f"Scene({self.name!r}, {counted(self.n_triangles, 'triangle')}{duration}, up={self.up!r})"


def procedural(name: str = "atrium", triangles: int | None = None, seed: int = 0) -> Scene:
    """A procedural scene with a camera and a quad light. Equal arguments give the same scene on every machine.

    Parameters
    ----------
    name : "atrium", "city", "forest", or the name of a scene added by a package (``antumbra scenes`` lists all)
    triangles : int, optional
        Approximate number of triangles, within 10 %. Each scene has its own default.
    seed : int
        Random seed for the arrangement of objects.

    Raises
    ------
    InputError
        If the name is unknown, or the number of triangles is out of range.

    Examples
    --------
    >>> at.procedural("city", triangles=5_000).bounds.round()
    array([[-70.,  -0., -70.],
           [ 70.,  33.,  70.]])
    """
    return Scene.of_data(procedural_data(name, triangles, seed))


def is_outside(scene: AnyScene, camera: Camera) -> bool:
    """Whether the camera is outside a scene, so that pictures show a ground below it.

    The scene may already contain ground, whose shadows then continue beyond its edge.
    """
    if camera.projection == "panoramic":
        return False
    if ((camera.position > scene.bounds[0]) & (camera.position < scene.bounds[1])).all():
        return False
    try:
        return scene.view.room is None
    except InputError:  # at some time the scene has no triangles: that frame reports the error
        return False
