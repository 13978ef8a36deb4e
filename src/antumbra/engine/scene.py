"""Scenes in memory, as users have them."""

from ..scene.cityjson.model import CityModel
from ..scene.generated import generated
from ..scene.made import data_of_arrays, data_of_mesh
from ..scene.memory import MemoryData
from ..scene.source import Source
from .any_scene import AnyScene, Of


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

    data: MemoryData
    source = Of[Source]()

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
        super().__init__(MemoryData(source, name=name, up=up, notes=notes, city=city, crs=crs))

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
        data = data_of_arrays(
            vertices, faces, colours, vertex_colours=vertex_colours, uv=uv, texture=texture, normals=normals, name=name,
            up=up, crs=crs,
        )  # fmt: skip
        return cls.of_data(data)

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
        return cls.of_data(data_of_mesh(mesh, name=name, up=up, crs=crs))

    def __repr__(self) -> str:
        moving = f", duration={self.duration:g}" if self.animated else ""
        return f"Scene({self.name!r}, {self.n_triangles} triangles{moving}, up={self.up!r})"


def procedural(name: str = "atrium", triangles: int | None = None, seed: int = 0) -> Scene:
    """A procedural scene with a camera and a quad light. Equal arguments give the same scene on every machine.

    Parameters
    ----------
    name : "atrium", "city", "forest", or the name of a scene that a package adds (``antumbra scenes`` lists all)
    triangles : int, optional
        Number of triangles, met within 10 %. Each scene has its own default.
    seed : int
        Another seed scatters the clutter differently.

    Raises
    ------
    InputError
        On an unknown name, or a number of triangles out of range.
    """
    return Scene.of_data(generated(name, triangles, seed))
