"""Meshes of other libraries: trimesh itself, and objects that look like those of the others."""

from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from PIL import Image

import antumbra as at
from antumbra import InputError
from antumbra.integrations.open3d import RaycastingScene
from antumbra.scene.materials import srgb_to_linear
from gltf_files import TETRAHEDRON, TETRAHEDRON_FACES, assert_at

CORNERS = TETRAHEDRON[TETRAHEDRON_FACES]
BYTES = np.random.default_rng(5).integers(0, 256, (4, 4)).astype(np.uint8)
MEAN_OF_CORNERS = srgb_to_linear(BYTES[:, :3] / 255.0)[TETRAHEDRON_FACES].mean(axis=1)


def tetrahedron(**more) -> trimesh.Trimesh:
    return trimesh.Trimesh(TETRAHEDRON, TETRAHEDRON_FACES, process=False, **more)


class Arrays(dict):
    """Named arrays of points or cells, as pyvista and meshio have them."""


def polydata(point_data=(), cell_data=()):
    faces = np.column_stack([np.full(4, 3), TETRAHEDRON_FACES]).reshape(-1)
    made = SimpleNamespace(points=TETRAHEDRON, faces=faces, n_cells=4, strips=None)
    made.point_data, made.cell_data = Arrays(point_data), Arrays(cell_data)
    made.triangulate = made.extract_surface = lambda: made
    return made


def open3d_mesh(colours=None):
    return SimpleNamespace(
        vertices=TETRAHEDRON.tolist(),
        triangles=TETRAHEDRON_FACES.tolist(),
        vertex_colors=colours,
        has_vertex_colors=lambda: colours is not None,
    )


def meshio_mesh(*cells, points=TETRAHEDRON, point_data=()):
    blocks = [SimpleNamespace(type=kind, data=np.array(data)) for kind, data in cells]
    return SimpleNamespace(points=points, cells=blocks, cells_dict={}, point_data=Arrays(point_data))


OF_VERTICES = {
    "trimesh": tetrahedron(vertex_colors=BYTES),
    "pyvista": polydata({"weights": np.zeros(4), "RGBA": BYTES}),
    "meshio": meshio_mesh(("triangle", TETRAHEDRON_FACES), point_data={"colors": BYTES}),
    "open3d": open3d_mesh(BYTES[:, :3] / 255.0),
    "open3d tensors": SimpleNamespace(vertex=1, triangle=1, to_legacy=lambda: open3d_mesh(BYTES[:, :3] / 255.0)),
}


@pytest.mark.parametrize("mesh", OF_VERTICES.values(), ids=OF_VERTICES)
def test_positions_and_colours_of_vertices(mesh):
    for scene in at.load(mesh, up="z"), at.Scene.from_mesh(mesh, up="z"):
        assert_at(scene, CORNERS)
        assert scene.up == "z" and scene.notes == ()
        np.testing.assert_allclose(scene.colours, MEAN_OF_CORNERS, atol=1e-6)


def test_colours_of_faces():
    wanted = srgb_to_linear(BYTES[:, :3] / 255.0)
    for mesh in tetrahedron(face_colors=BYTES), polydata(cell_data={"shade": BYTES}):
        np.testing.assert_allclose(at.load(mesh).colours, wanted, atol=1e-6)


def test_a_material_has_its_mean_colour():
    half = np.zeros((2, 2, 3), np.uint8)
    half[0] = 255
    material = trimesh.visual.material.PBRMaterial(
        baseColorFactor=[255, 51, 0, 255], baseColorTexture=Image.fromarray(half)
    )
    visual = trimesh.visual.TextureVisuals(material=material)
    np.testing.assert_allclose(at.load(tetrahedron(visual=visual)).colours, [[0.5, 0.1, 0.0]] * 4, atol=1e-6)


@pytest.mark.parametrize("v, shade", [(0.1, 0.0), (0.9, 1.0)])  # trimesh counts v from below
def test_a_face_has_the_mean_colour_of_its_part_of_a_texture(v, shade):
    half = np.zeros((2, 2, 3), np.uint8)
    half[0] = 255
    uv = np.array([[0.1, v], [0.2, v], [0.1, v + 0.05], [0.2, v + 0.05]])
    material = trimesh.visual.material.SimpleMaterial(image=Image.fromarray(half), diffuse=[255, 51, 0, 255])
    scene = at.load(tetrahedron(visual=trimesh.visual.TextureVisuals(uv=uv, material=material)))
    np.testing.assert_allclose(scene.colours, [[shade, 0.2 * shade, 0.0]] * 4, atol=1e-6)
    assert scene.appearance.uv.shape == (4, 3, 2) and scene.appearance.textured.all()


def _square(**fields):
    """A square of four faces with texture coordinates and a PBRMaterial, in a trimesh scene with y up."""
    corners = np.array([[x, 0.0, z] for z in (-1.0, 0.0, 1.0) for x in (-1.0, 1.0)])
    uv = [[(x + 1.0) / 2.0, (z + 1.0) / 2.0] for x, _, z in corners]
    material = trimesh.visual.material.PBRMaterial(name="m", **fields)
    faces = [[0, 2, 1], [1, 2, 3], [2, 4, 3], [3, 4, 5]]
    visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    return trimesh.Scene(trimesh.Trimesh(corners, faces, visual=visual, process=False))


_NOISE = Image.fromarray(np.random.default_rng(3).integers(60, 250, (8, 8, 3), np.uint8))
_PBR = {
    "factors": {"metallicFactor": 0.3, "roughnessFactor": 0.4},
    "the defaults of glTF": {},
    "a map of metal and roughness": {"metallicRoughnessTexture": _NOISE},
    "a normal map": {"metallicFactor": 0.0, "normalTexture": _NOISE},
    "occlusion": {"metallicFactor": 0.0, "occlusionTexture": _NOISE},
    "emission": {"metallicFactor": 0.0, "emissiveFactor": [0.5, 0.25, 1.0], "emissiveTexture": _NOISE},
}


@pytest.mark.parametrize("fields", _PBR.values(), ids=_PBR)
def test_materials_of_trimesh_look_like_the_gltf_file_that_trimesh_writes(fields, tmp_path):
    made = _square(baseColorFactor=[200, 120, 40, 255], baseColorTexture=_NOISE, **fields)
    made.export(tmp_path / "square.glb")
    scenes = at.load(made, up="y"), at.load(tmp_path / "square.glb")
    camera = at.Camera((0.3, 2.0, 2.2), (0.0, 0.0, 0.0), width=40, height=30)
    lamp = at.PointLight((0.4, 1.5, -0.8), intensity=3.0)
    ours, files, diffuse = (
        at.render(scene, camera, [lamp], spp=1, materials=materials).image
        for scene, materials in zip((*scenes, scenes[0]), ("pbr", "pbr", "diffuse"))
    )
    np.testing.assert_array_equal(ours, files)
    assert not np.array_equal(ours, diffuse)


def test_simple_and_rough_materials_of_trimesh_are_diffuse():
    simple = trimesh.visual.material.SimpleMaterial(diffuse=[10, 200, 30, 255])
    rough = trimesh.visual.material.PBRMaterial(metallicFactor=0.0, roughnessFactor=1.0)
    for material in simple, rough:
        visual = trimesh.visual.TextureVisuals(uv=np.zeros((4, 2)), material=material)
        looks = at.load(tetrahedron(visual=visual)).appearance
        assert looks is None or looks.pbr is None


def test_each_node_of_a_trimesh_scene_is_an_object():
    scene, moved = trimesh.Scene(), trimesh.transformations.translation_matrix([5.0, 0.0, 0.0])
    scene.add_geometry(tetrahedron(), node_name="here", geom_name="t")
    scene.graph.update("there", geometry="t", matrix=moved)
    scene.add_geometry(trimesh.load_path([[[0, 0], [1, 1]]]), geom_name="lines")
    with pytest.warns(UserWarning, match="'lines' is a Path"):
        made = at.load(scene)
    assert [o.name for o in made.objects] == ["here", "there"]
    assert_at(made, np.concatenate([CORNERS, CORNERS + [5.0, 0.0, 0.0]]))


def test_cells_of_meshio():
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0], [1, 0.5], [0.5, 0.5]], float)
    cells = ("quad", [[0, 1, 2, 3]]), ("triangle6", [[0, 1, 2, 4, 5, 6]]), ("line", [[0, 1]]), ("tetra", [[0, 1, 2, 3]])
    with pytest.warns(UserWarning, match="left out 1 cell of kind 'tetra'"):
        made = at.load(meshio_mesh(*cells, points=square))
    flat = np.column_stack([square, np.zeros(7)])
    assert_at(made, flat[[[0, 1, 2], [0, 2, 3], [0, 1, 2]]])


def test_blocks_of_pyvista_are_objects():
    class Blocks:
        is_all_polydata = True

        def keys(self):
            return ["a", "empty", "b"]

        def __getitem__(self, i):
            return [polydata(), None, polydata()][i]

    made = at.load(Blocks())
    assert [o.name for o in made.objects] == ["a", "b"] and made.n_triangles == 8


@pytest.mark.parametrize(
    "mesh, words",
    [
        (None, "scene is of type NoneType; give the path of a file, a scene, a DataArray, or a mesh of trimesh"),
        (np.zeros((3, 3)), "arrays go to Scene.from_arrays"),
        (trimesh.Trimesh(), "the Trimesh has no triangles"),
        (meshio_mesh(("hexahedron", [[0, 1, 2, 3, 0, 1, 2, 3]])), "has no triangles.*extract_surface"),
        (meshio_mesh(("triangle", [[0, 1, 9]])), "face 0 uses the vertices 0, 1, 9"),
        (meshio_mesh(("triangle", [[0, 1, 2]]), points=np.full((3, 3), np.nan)), "vertex 0 is"),
        (meshio_mesh(("triangle", [[0, 1, 2]]), points=np.array([["a"] * 3] * 3)), "vertices must be numbers"),
    ],
)
def test_bad_objects_are_refused(mesh, words):
    with pytest.raises(InputError, match=words):
        at.load(mesh)


def test_another_object_is_no_mesh():
    with pytest.raises(InputError, match=r"types\.SimpleNamespace is not a mesh of trimesh"):
        at.Scene.from_mesh(SimpleNamespace())


@pytest.mark.parametrize("soup", [False, True])
def test_arrays_with_bytes_and_colours_of_vertices(soup):
    arguments = (CORNERS, None) if soup else (TETRAHEDRON, TETRAHEDRON_FACES)
    bytes_ = BYTES[TETRAHEDRON_FACES].reshape(-1, 4) if soup else BYTES
    linear = srgb_to_linear(bytes_[:, :3] / 255.0)
    for given in bytes_, linear, linear.astype(np.float32):
        made = at.Scene.from_arrays(*arguments, vertex_colours=given)
        np.testing.assert_allclose(made.colours, MEAN_OF_CORNERS, atol=1e-6)
    made = at.Scene.from_arrays(*arguments, BYTES)
    np.testing.assert_allclose(made.colours, srgb_to_linear(BYTES[:, :3] / 255.0), atol=1e-6)


@pytest.mark.parametrize(
    "colours, words",
    [
        ({"colours": np.full((4, 3), 255.0)}, "give uint8 for 0 to 255"),
        ({"colours": np.full((4, 3), 255)}, "must be float .* or uint8"),
        ({"colours": np.ones((5, 3))}, r"colours of 4 faces have shape \(5, 3\); .* or vertex_colours"),
        ({"vertex_colours": np.ones((5, 3))}, r"vertex_colours of 4 vertices have shape \(5, 3\)"),
        ({"colours": np.ones(3), "vertex_colours": np.ones((4, 3))}, "exclude each other"),
    ],
)
def test_bad_colours_are_refused(colours, words):
    with pytest.raises(InputError, match=words):
        at.Scene.from_arrays(TETRAHEDRON, TETRAHEDRON_FACES, **colours)


def installed(name: str):
    reason = f"no {name}: only objects that look like its meshes are checked"
    return pytest.importorskip(name, reason=reason, exc_type=ImportError)


def test_data_sets_of_pyvista():
    pyvista = installed("pyvista")
    sphere = pyvista.Sphere()
    corners = sphere.points[sphere.regular_faces]
    assert_at(at.load(sphere), corners)
    grid = pyvista.ImageData(dimensions=(3, 3, 3))
    assert at.load(grid).n_triangles == 2 * 6 * 4


def test_meshes_of_meshio():
    meshio = installed("meshio")
    assert_at(at.load(meshio.Mesh(TETRAHEDRON, [("triangle", TETRAHEDRON_FACES)])), CORNERS)


@pytest.mark.parametrize("kind", ["legacy", "tensors"])
def test_meshes_of_open3d(kind):
    open3d = installed("open3d")
    mesh = open3d.geometry.TriangleMesh()
    mesh.vertices, mesh.triangles = (
        open3d.utility.Vector3dVector(TETRAHEDRON),
        open3d.utility.Vector3iVector(TETRAHEDRON_FACES),
    )
    mesh.vertex_colors = open3d.utility.Vector3dVector(BYTES[:, :3] / 255.0)
    if kind == "tensors":
        mesh = open3d.t.geometry.TriangleMesh.from_legacy(mesh)
    scene = at.load(mesh)
    assert_at(scene, CORNERS)
    np.testing.assert_allclose(scene.colours, MEAN_OF_CORNERS, atol=1e-6)


SCENE_ARGUMENTS = {
    "load": lambda mesh: at.load(mesh).closest_hit(*RAY).t,
    "Engine": lambda mesh: at.Engine(mesh).closest_hit(*RAY).t,
    "visibility": lambda mesh: at.visibility(mesh, RAY[0], at.PointLight((0, 0, -9)), spp=1).bits,
    "render": lambda mesh: at.render(mesh, CAMERA, at.PointLight((1, 2, 5)), spp=1).image,
    "sky_view": lambda mesh: at.sky_view(mesh, directions=16)["sky_view"],
    "trimesh_ray or RaycastingScene": lambda mesh: RaycastingScene().add_triangles(mesh),
}
RAY = (0.2, 0.2, 5.0), (0.0, 0.0, -1.0)
CAMERA = at.Camera((1, 2, 5), (0.3, 0.3, 0.3), width=16, height=16)


@pytest.mark.parametrize("call", SCENE_ARGUMENTS.values(), ids=SCENE_ARGUMENTS)
def test_all_libraries_are_accepted_wherever_a_scene_is(call):
    wanted = call(trimesh.Scene(tetrahedron()))
    for mesh in OF_VERTICES.values():
        assert np.array_equal(np.isfinite(call(mesh)), np.isfinite(wanted)) and np.shape(call(mesh)) == np.shape(wanted)
