"""OBJ, PLY and STL."""

import logging
import struct
import sys

import numpy as np
import pytest

from antumbra.base.errors import InputError
from antumbra.engine.scene_loading import load
from antumbra.formats import mesh_files
from formats.gltf.test_gltf_materials import linear
from gltf_files import TETRAHEDRON, TETRAHEDRON_FACES, assert_at, png

SOLID = TETRAHEDRON[TETRAHEDRON_FACES]


def obj_text(vertices=TETRAHEDRON, faces=TETRAHEDRON_FACES, head=""):
    lines = [head, *("v " + " ".join(repr(float(c)) for c in v) for v in vertices)]
    lines += ["f " + " ".join(str(i + 1) for i in f) for f in faces]
    return "\n".join(lines) + "\n"


def ply_text(vertices=TETRAHEDRON, faces=TETRAHEDRON_FACES, kind="double", n_vertices=None, n_faces=None):
    head = ["ply", "format ascii 1.0", f"element vertex {n_vertices or len(vertices)}"]
    head += [f"property {kind} {c}" for c in "xyz"] + [f"element face {n_faces or len(faces)}"]
    head += ["property list uchar int vertex_indices", "end_header"]
    body = [" ".join(repr(float(c)) for c in v) for v in vertices]
    return "\n".join(head + body + ["3 " + " ".join(map(str, f)) for f in faces]) + "\n"


def ply_binary(n_faces=4):
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 4\n"
    head += "".join(f"property float {c}\n" for c in "xyz")
    head += f"element face {n_faces}\nproperty list uchar int vertex_indices\nend_header\n"
    faces = b"".join(struct.pack("<B3i", 3, *f) for f in TETRAHEDRON_FACES.tolist())
    return head.encode() + TETRAHEDRON.tobytes() + faces


def stl_binary(count=4):
    facets = b"".join(struct.pack("<12fH", 0, 0, 0, *t.reshape(-1).tolist(), 0) for t in SOLID)
    return bytes(80) + struct.pack("<I", count) + facets


def stl_text():
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n" + "".join("vertex {} {} {}\n".format(*v) for v in t) + "endloop\nendfacet\n"
        for t in SOLID.tolist()
    )
    return f"solid a\n{facets}endsolid a\n"


def put(folder, name, content):
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


@pytest.mark.parametrize(
    "name, content",
    [
        ("a.obj", obj_text()),
        ("a.OBJ", obj_text().replace("f 1 3 2", "f -4 -2 -3")),
        ("a.ply", ply_text()),
        ("b.ply", ply_binary()),
        ("a.stl", stl_binary()),
        ("b.stl", stl_text()),
    ],
)
def test_formats(tmp_path, name, content):
    scene = load(put(tmp_path, name, content))
    assert_at(scene, SOLID)
    assert scene.meshes[0].triangles == 4 and scene.name == name[0]
    assert scene.cameras == [] and scene.lights == [] and scene.duration == 0.0


@pytest.mark.parametrize("name", ["a.obj", "a.ply"])
def test_map_coordinates_keep_their_precision(tmp_path, name):
    vertices = np.random.default_rng(0).uniform(-50, 50, (4, 3)) + np.array([448262.0, 5411932.0, 120.0])
    text = obj_text(vertices) if name == "a.obj" else ply_text(vertices)
    scene = load(put(tmp_path, name, text), up="z")
    expected = (vertices[TETRAHEDRON_FACES] - scene.origin).astype(np.float32)
    np.testing.assert_array_equal(scene.triangles().vertices, expected)


def test_polygons_are_cut_into_triangles(tmp_path):
    scene = load(put(tmp_path, "a.obj", "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\nf 1 2 3\n"))
    assert scene.n_triangles == 3
    triangles = scene.triangles().vertices.astype(float)
    areas = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1) / 2
    np.testing.assert_allclose(sorted(areas), [0.5, 0.5, 0.5])


def test_zero_area_triangles_are_kept(tmp_path):
    assert load(put(tmp_path, "a.obj", obj_text(faces=[(0, 0, 1), (0, 1, 2), (3, 3, 3)]))).n_triangles == 3


def test_obj_materials_and_textures_from_the_folder(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 256, (4, 4, 3))
    (tmp_path / "t.png").write_bytes(png(pixels))
    put(tmp_path, "m.mtl", "newmtl red\nKd 1 0 0\nnewmtl wood\nKd 1 1 1\nmap_Kd t.png\n")
    text = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0.1 0.1\n"
    text += "usemtl red\nf 1/1 2/1 3/1\nusemtl wood\nf 1/1 2/1 4/1\n"
    scene = load(put(tmp_path, "a.obj", text))
    mean = [linear(v / 255) for v in pixels[3, 0].tolist()]  # OBJ counts v from below
    by_corner = {bool(t[..., 2].max() > t[..., 2].min()): c for t, c in zip(scene.triangles().vertices, scene.colours)}
    np.testing.assert_allclose(by_corner[False], [1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(by_corner[True], mean, rtol=1e-6)


def test_ply_vertex_colours_are_srgb(tmp_path):
    text = ply_text().replace(
        "property double z\n",
        "property double z\n" + "".join(f"property uchar {c}\n" for c in ("red", "green", "blue")),
    )
    lines = text.splitlines()
    at = lines.index("end_header") + 1
    shades = [(0, 10, 255), (255, 20, 255), (50, 30, 255), (100, 40, 255)]
    lines[at : at + 4] = [f"{line} {r} {g} {b}" for line, (r, g, b) in zip(lines[at : at + 4], shades)]
    scene = load(put(tmp_path, "a.ply", "\n".join(lines) + "\n"))
    value = np.array([[linear(c / 255) for c in shade] for shade in shades])
    np.testing.assert_allclose(scene.colours, value[TETRAHEDRON_FACES].mean(axis=1), rtol=1e-6)


@pytest.mark.parametrize(
    "library", ["../m.mtl", "/etc/passwd", "http://example.org/m.mtl", "sub/../../m.mtl", "gone.mtl"]
)
def test_material_files_outside_the_folder_are_not_read(tmp_path, library):
    put(tmp_path, "m.mtl", "newmtl red\nKd 1 0 0\n")
    (tmp_path / "in").mkdir()
    path = put(tmp_path / "in", "a.obj", obj_text(head=f"mtllib {library}\nusemtl red"))
    with pytest.warns(UserWarning, match=r"a.obj: file"):
        scene = load(path)
    assert (scene.colours == 1).all() and len(scene.notes) == 1


def test_the_parsers_log_stays_off_the_screen(tmp_path, capfd, monkeypatch):
    monkeypatch.setattr(logging.root, "handlers", [])  # like a program without logging
    assert load(put(tmp_path, "a.stl", stl_text().replace("normal 0 0 0", "normal 0 x 0"))).n_triangles == 4
    assert capfd.readouterr() == ("", "")


WRONG = {
    "empty.obj": ("", "is empty"),
    "points.obj": (obj_text(faces=[]), "no triangles"),
    "edges.obj": (obj_text(faces=[(0, 1)]), "no triangles"),
    "high.obj": (obj_text(faces=[(0, 1, 9)]), "missing vertex"),
    "low.obj": (obj_text() + "f 1 2 -9\n", "missing vertex"),
    "zero.obj": (obj_text() + "f 1 0 2\n", "line 10 uses vertex 0"),
    "zero2.obj": (obj_text() + "f 1/1 2/1 0/1\n", "line 10 uses vertex 0"),
    "nan.obj": (obj_text(TETRAHEDRON * np.nan), "vertex 0 is (nan, nan, nan)"),
    "inf.obj": (obj_text().replace("v 1.0", "v 1e999"), "vertex 1 is (inf, 0.0, 0.0)"),
    "flat.obj": ("v 0 0\nv 1 0\nv 0 1\nf 1 2 3\n", "a vertex is x y z"),
    "letters.obj": (obj_text() + "f a b c\n", "cannot be read"),
    "bytes.obj": (bytes(range(256)) * 4, "no triangles"),
    "empty.ply": ("", "is empty"),
    "high.ply": (ply_text(faces=[(0, 1, 4)]), "face 0 uses the vertices 0, 1, 4"),
    "low.ply": (ply_text(faces=[(0, 1, -1)]), "face 0 uses the vertices 0, 1, -1"),
    "many.ply": (ply_text(n_vertices=4_000_000_000), "PLY header declares 4,000,000,004 elements"),
    "many2.ply": (ply_binary(n_faces=4_000_000_000), "PLY header declares 4,000,000,004 elements"),
    "short.ply": (ply_binary()[:-7], "5 are left; the file is cut short"),
    "nan.ply": (ply_text(TETRAHEDRON * np.nan), "vertex 0"),
    "points.ply": (ply_text(faces=[]), "no triangles"),
    "empty.stl": ("", "is empty"),
    "short.stl": (stl_binary()[:-9], "STL header needs 284 bytes, there are 275"),
    "many.stl": (stl_binary(4_000_000_000), "STL header needs 200000000084 bytes"),
    "none.stl": (stl_binary(0)[:84], "no triangles"),
    "nan.stl": (
        stl_binary().replace(struct.pack("<f", 1.0), struct.pack("<f", np.nan)),
        "vertex 1 is (0.0, nan, 0.0)",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_bad_mesh_files(tmp_path, name):
    content, words = WRONG[name]
    with pytest.raises(InputError) as caught:
        load(put(tmp_path, name, content))
    message = str(caught.value)
    assert words in message and message.startswith(name) and "\n" not in message


OBJ_NAMES = {
    "o Cube\n": ["Cube", "Cube_1", "Cube_2"],
    "o Cube_001\n": ["Cube_001", "Cube_2", "Cube_3"],
    "o A_0\n": ["A_0", "A_1", "A_2"],
    "o _5\n": ["_5", "_6", "_7"],
    "o two words \n": ["two words", "two words_1", "two words_2"],
    "o \n": ["geometry_1", "geometry_2", "geometry_3"],
    "": ["geometry", "geometry_1", "geometry_2"],
}


@pytest.mark.parametrize("head", OBJ_NAMES, ids=repr)
def test_meshes_without_materials_are_numbered(tmp_path, head):
    faces = "".join(f"usemtl {m}\nf 1 2 {k}\n" for m, k in zip("abca", (3, 4, 3, 4)))
    scene = load(put(tmp_path, "a.obj", head + obj_text(faces=[]) + faces))
    assert [mesh.name for mesh in scene.meshes] == OBJ_NAMES[head]


def ply_rows(vertices, faces, order="<", kind="f4", **more):
    """A binary PLY file; `more`: further columns of vertices."""
    names = {"f4": "float", "f8": "double", "u1": "uchar"}
    columns = dict(zip("xyz", np.asarray(vertices).T)) | more
    types = [(name, order + ("u1" if name in ("red", "green", "blue", "alpha") else kind)) for name in columns]
    rows = np.empty(len(vertices), types)
    for name, values in columns.items():
        rows[name] = values
    corners = b"".join(struct.pack(f"{order}B{len(face)}I", len(face), *map(int, face)) for face in faces)
    head = ["ply", f"format binary_{'little' if order == '<' else 'big'}_endian 1.0", "comment made by hand"]
    head += [f"element vertex {len(vertices)}", *(f"property {names[t[1:]]} {name}" for name, t in types)]
    head += [f"element face {len(faces)}", "property list uchar uint vertex_index", "end_header", ""]
    return "\n".join(head).encode() + rows.tobytes() + corners


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("kind", ["f4", "f8"])
@pytest.mark.parametrize("has_colours", [False, True])
@pytest.mark.parametrize("has_normals", [False, True])
def test_binary_files_are_read_as_by_trimesh_without_it(tmp_path, monkeypatch, order, kind, has_colours, has_normals):
    rng = np.random.default_rng(4)
    vertices, faces = rng.normal(size=(50, 3)).astype(kind), rng.integers(0, 50, (70, 3))
    more = {}
    if has_normals:
        more |= dict(zip(("nx", "ny", "nz"), rng.normal(size=(3, 50)).astype(kind)))
    if has_colours:
        more |= dict(zip(("red", "green", "blue"), rng.integers(0, 256, (3, 50), np.uint8)))
    path = put(tmp_path, "a.ply", ply_rows(vertices, faces, order, kind, **more))
    with monkeypatch.context() as patch:
        patch.setattr(mesh_files, "_read_triangles", lambda *arguments: None)
        wanted = load(path)
    monkeypatch.setitem(sys.modules, "trimesh", None)  # importing it fails
    scene = load(path)
    for made in (scene, wanted):
        np.testing.assert_array_equal(
            made.triangles().vertices, (vertices[faces].astype(float) - made.origin).astype(np.float32)
        )
    np.testing.assert_array_equal(scene.colours, wanted.colours)
    assert (scene.appearance is None) == (wanted.appearance is None) == (not has_colours and not has_normals)
    if has_normals:
        np.testing.assert_array_equal(scene.appearance.normals, wanted.appearance.normals)
    if has_colours:
        np.testing.assert_array_equal(scene.appearance.colours, wanted.appearance.colours)
        assert len(np.unique(scene.colours)) > 50


def test_binary_stl_needs_no_trimesh(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "trimesh", None)
    assert_at(load(put(tmp_path, "a.stl", stl_binary())), SOLID)


@pytest.mark.parametrize("kind", ["float", "double"])
def test_text_files_are_read_as_by_trimesh_without_it(tmp_path, monkeypatch, kind):
    vertices = np.random.default_rng(5).normal(size=(4, 3))
    text = ply_text(vertices, kind=kind).replace(
        f"property {kind} z\n",
        f"property {kind} z\n" + "".join(f"property uchar {c}\n" for c in ("red", "green", "blue")),
    )
    lines = text.splitlines()
    at = lines.index("end_header") + 1
    lines[at : at + 4] = [f"{line} {50 * k} {90 - k} 255" for k, line in enumerate(lines[at : at + 4])]
    (tmp_path / "binary").mkdir()
    ply, stl = put(tmp_path, "a.ply", "\n".join(lines) + "\n"), put(tmp_path, "a.stl", stl_text())
    with monkeypatch.context() as patch:
        patch.setattr(mesh_files, "_read_triangles", lambda *arguments: None)
        wanted = load(ply), load(put(tmp_path / "binary", "a.stl", stl_binary()))
    monkeypatch.setitem(sys.modules, "trimesh", None)
    for path, other in zip((ply, stl), wanted):
        scene = load(path)
        np.testing.assert_array_equal(scene.triangles().vertices, other.triangles().vertices)
        np.testing.assert_array_equal(scene.colours, other.colours)
        assert scene.meshes == other.meshes
    assert len(np.unique(wanted[0].colours)) > 4


@pytest.mark.parametrize("is_text", [False, True])
def test_colours_of_faces(tmp_path, monkeypatch, is_text):
    colours = np.random.default_rng(6).integers(0, 256, (4, 3), np.uint8)
    channels = "".join(f"property uchar {c}\n" for c in ("red", "green", "blue"))
    if is_text:
        lines = ply_text().replace("end_header\n", channels + "end_header\n").splitlines()
        rows = [f"{line} {' '.join(map(str, rgb))}" for line, rgb in zip(lines[-4:], colours.tolist())]
        path = put(tmp_path, "a.ply", "\n".join(lines[:-4] + rows) + "\n")
    else:
        head, body = ply_binary().split(b"end_header\n")
        faces = [body[-13 * (4 - k) :][:13] + rgb.tobytes() for k, rgb in enumerate(colours)]
        path = put(tmp_path, "a.ply", head + channels.encode() + b"end_header\n" + body[: -13 * 4] + b"".join(faces))
    monkeypatch.setitem(sys.modules, "trimesh", None)
    scene = load(path)
    np.testing.assert_allclose(scene.colours, [[linear(c / 255) for c in rgb] for rgb in colours.tolist()], rtol=1e-6)
    assert_at(scene, SOLID)


def test_solids_of_an_stl_file_are_meshes(tmp_path):
    text = stl_text().replace("solid a\n", "solid left part\n", 1) + stl_text().upper().replace("SOLID A", "SOLID b")
    scene = load(put(tmp_path, "a.stl", text))
    assert [(mesh.name, mesh.triangles) for mesh in scene.meshes] == [("left part", 4), ("b", 4)]


@pytest.mark.parametrize("words", ["0 0 x", "0 0"])
def test_damaged_text_of_stl_is_refused(tmp_path, words):
    with pytest.raises(InputError, match=r"a\.stl"):
        load(put(tmp_path, "a.stl", stl_text().replace("vertex 0.0 0.0 0.0", f"vertex {words}", 1)))


def test_unusual_ply_is_left_to_trimesh(tmp_path):
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)
    assert load(put(tmp_path, "a.ply", ply_rows(square, [(0, 1, 2, 3)]))).n_triangles == 2
    text = ply_text(square, [(0, 1, 2)]).replace("3 0 1 2", "4 0 1 2 3")
    assert load(put(tmp_path, "c.ply", text)).n_triangles == 2
    data = ply_rows(square, [(0, 1, 2), (0, 2, 3)], s=square[:, 0], t=square[:, 1])
    assert load(put(tmp_path, "b.ply", data)).n_triangles == 2
