"""Text and tables that are cut, doubled or misspelt: an error or a note, never a scene that lacks a part silently."""

import re
import struct

import numpy as np
import pytest

import antumbra as at
from antumbra.city.sensors.sensor_files import read_points
from antumbra.city.vegetation.vegetation_table import VegetationOptions, read_vegetation
from formats.test_mesh_files import obj_text, ply_rows, ply_text, put, stl_binary

HEAD = ply_text().partition("end_header\n")[0] + "end_header\n"
VERTICES = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
FACES = ["3 0 1 2", "3 0 1 3", "3 0 2 3", "4 0 1 2 3"]  # not all triangles: read by trimesh


def ply(*faces, vertices=VERTICES, head=HEAD) -> str:
    return head + vertices + "\n".join(faces) + "\n"


CUT_PLY = {
    "a face is missing": ply(*FACES[:3]),
    "a face too many": ply(*FACES, FACES[0]),
    "a vertex is missing": ply(*FACES, vertices=VERTICES[6:]),
    "a vertex too many": ply(*FACES, vertices=VERTICES + "1 1 1\n"),
    "a number is missing": ply(*FACES, vertices=VERTICES.replace("1 0 0", "1 0")),
    "a number too many": ply(*FACES, vertices=VERTICES.replace("1 0 0", "1 0 0 7")),
    "a corner is missing": ply(*FACES[:3], "4 0 1 2"),
    "a word among numbers": ply(*FACES, vertices=VERTICES.replace("1 0 0", "1 x 0")),
    "a word among corners": ply(*FACES[:3], "4 0 1 2 q"),
    "a corner that is not whole": ply(*FACES[:3], "4 0 1 2 2.5"),
    "a list of -1 corners": ply(*FACES[:3], "-1 0 1 2"),
    "a list of 2^31 corners": ply(*FACES[:3], "2147483648 0 1 2"),
    "a count of -1 faces": ply(*FACES, head=HEAD.replace("face 4", "face -1")),
    "a count in words": ply(*FACES, head=HEAD.replace("face 4", "face four")),
    "an unknown type": ply(*FACES, head=HEAD.replace("property double z", "property real z")),
    "no end of the header": ply(*FACES, head=HEAD.replace("end_header", "end header")),
}


@pytest.mark.parametrize("name", CUT_PLY)
@pytest.mark.parametrize("keep", [False, True])
def test_rows_of_ply_files_are_those_of_the_header(tmp_path, name, keep):
    text = CUT_PLY[name].replace("4 0 1 2 3", "3 1 2 3") if keep else CUT_PLY[name]  # of triangles only, if possible
    with pytest.raises(at.InputError) as caught:
        at.load(put(tmp_path, "a.ply", text))
    assert str(caught.value).startswith("a.ply: ") and "damaged" not in str(caught.value)


def test_rows_of_ply_files_that_are_complete(tmp_path):
    scene = at.load(put(tmp_path, "a.ply", ply(*FACES)))
    assert scene.n_triangles == 5 and not scene.notes


@pytest.mark.parametrize("count, words", [(-1, "says it has -1 entries"), (2**31 - 1, "2,147,483,647 entries: needs")])
def test_lists_of_binary_ply_files_name_their_length(tmp_path, count, words):
    data = ply_rows(np.eye(4)[:, :3], [(0, 1, 2)]).replace(b"list uchar uint", b"list int uint")
    head, _, body = data.partition(b"end_header\n")
    body = body[:48] + struct.pack("<i", count) + body[49:]
    with pytest.raises(at.InputError, match=re.escape(words)):
        at.load(put(tmp_path, "a.ply", head + b"end_header\n" + body))


@pytest.mark.parametrize("change", [lambda data: data[:-2], lambda data: data[:-17], lambda data: data + b"\0"])
def test_binary_ply_files_end_where_they_say(tmp_path, change):
    data = ply_rows(np.eye(4)[:, :3], [(0, 1, 2, 3), (0, 1, 2, 3)])
    assert at.load(put(tmp_path, "a.ply", data)).n_triangles == 4
    with pytest.raises(at.InputError, match=r"cut short|more than its PLY header declares"):
        at.load(put(tmp_path, "a.ply", change(data)))


def test_faces_of_two_corners_are_counted(tmp_path):
    for name, text in (("a.ply", ply(*FACES[:3], "2 0 1")), ("a.obj", obj_text() + "f 1 2\n")):
        with pytest.warns(UserWarning, match="left out 1 face with fewer than 3 corners"):
            assert at.load(put(tmp_path, name, text)).n_triangles == (3 if name == "a.ply" else 4)


def test_textures_that_ply_files_name_are_a_note(tmp_path, capfd):
    head = HEAD.replace("end_header", "comment TextureFile ../secret.png\nend_header")
    with pytest.warns(UserWarning, match=r"its texture '\.\./secret\.png' is not shown"):
        at.load(put(tmp_path, "a.ply", ply(*FACES, head=head)))
    assert capfd.readouterr() == ("", "")


FACET = "facet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"


def solid(*facets, name="a") -> str:
    return f"solid {name}\n{''.join(facets)}endsolid {name}\n"


CUT_STL = {
    **{f"cut at {n}": solid(FACET) + solid(FACET, FACET, name="b")[:n] for n in (9, 40, 120, 185)},
    "without its end": "solid a\n" + FACET,
    "a facet cut in its middle": solid(FACET, FACET[:60] + "\n"),
    "a facet without its end": solid(FACET, FACET.replace("endfacet\n", "")),
    "a facet of four vertices": solid(FACET, FACET.replace("endloop", "vertex 1 1 1\nendloop")),
    "facets of four and two vertices": solid(
        FACET.replace("endloop", "vertex 1 1 1\nendloop"), FACET.replace("vertex 1 0 0\n", "")
    ),
    "a vertex of two numbers": solid(FACET, FACET.replace("1 0 0", "1 0")),
    "a vertex of a word": solid(FACET, FACET.replace("1 0 0", "1 x 0")),
}  # fmt: skip


@pytest.mark.parametrize("name", CUT_STL)
def test_no_facet_of_an_stl_file_is_lost(tmp_path, name):
    with pytest.raises(at.InputError, match=r"^a\.stl: .*(cut short|export the mesh again)"):
        at.load(put(tmp_path, "a.stl", CUT_STL[name]))


@pytest.mark.parametrize("text", [solid(FACET), solid(FACET).upper(), solid(FACET)[:-3], "\n" + solid(FACET, name="")])
def test_whole_stl_files_are_read(tmp_path, text):
    assert at.load(put(tmp_path, "a.stl", text)).n_triangles == 1


def test_binary_stl_files_have_the_size_that_they_say(tmp_path):
    with pytest.raises(at.InputError, match="STL header needs 284 bytes, there are 287"):
        at.load(put(tmp_path, "a.stl", stl_binary() + b"abc"))
    named = b"solid of a facet" + stl_binary()[16:]
    assert at.load(put(tmp_path, "a.stl", named)).n_triangles == 4


@pytest.mark.parametrize(
    "line, words",
    [
        ("vt 0 0\nvt 1\nf 1/1 2/1 3/1", "line 11, of vt, has 1 number, and others 2"),
        ("vn 0 0 1\nvn 1 0\nf 1//1 2//1 3//1", "line 11, of vn, has 2 numbers, and others 3"),
        ("vn 0 0 1 1\nvn 1 0\nf 1//1 2//1 3//1", "line 11, of vn, has 2 numbers, and others 4"),
        ("v 1 1\nf 1 2 3", "line 10, of v, has 2 numbers, and others 3"),
        ("v 1 1 1 1\nv 1 1\nf 1 2 3", "line 11, of v, has 2 numbers, and others 4"),
    ],
)
def test_lines_of_obj_files_that_are_cut_are_named(tmp_path, line, words):
    with pytest.raises(at.InputError, match=words):
        at.load(put(tmp_path, "a.obj", obj_text() + line + "\n"))


@pytest.mark.parametrize(
    "line, words",
    [
        ("f 1/1 2/1 3/1", "faces use texture coordinates that the file lacks"),
        ("f 1//9 2//9 3//9", "faces use normals that the file lacks"),
        ("F 1 2 3", "left out 1 line of unknown words; line 10 begins with 'F'"),
        ("f", "left out 1 line of unknown words; line 10 begins with 'f'"),
    ],
)
def test_what_obj_files_lose_is_a_note(tmp_path, line, words):
    with pytest.warns(UserWarning, match=words):
        at.load(put(tmp_path, "a.obj", obj_text() + line + "\n"))


def test_usual_lines_of_obj_files_give_no_notes(tmp_path):
    more = "# a\n\no a\ng a b\ns off\nl 1 2\np 1\nvp 1 2\nbevel off\nlod 1\nusemtl a\n! b\n$ c\n"
    assert at.load(put(tmp_path, "a.obj", obj_text(head=more))).notes == ()


TABLES = {
    "decimal commas": ("x,y,z\n1,5,2,0,3,0\n", "line 2: has 6 fields, and the header 3; write decimal points"),
    "a column twice": ("x,y,z,x\n1,2,3,4\n", "has two columns 'x'"),
    "a word": ("x,y,z\n1,2,a\n", "lacks? a number|no place"),
    "an empty field": ("x,y,z\n1,,3\n", "lacks a number|no place"),
    "a field too few": ("x,y,z\n1\n", "lacks a number|no place"),
}


@pytest.mark.parametrize("name", TABLES)
def test_tables_of_points_and_trees_are_complete(tmp_path, name):
    text, words = TABLES[name]
    with pytest.raises(at.InputError, match=words):
        read_points(put(tmp_path, "a.csv", text))
    with pytest.raises(at.InputError, match=words):
        read_vegetation(put(tmp_path, "b.csv", text), VegetationOptions(height="z", radius=1.0))
