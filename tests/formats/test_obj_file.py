"""OBJ files against a parser that reads one line at a time; numbers against Python's float."""

import sys

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from antumbra.engine.scene_loading import load
from antumbra.formats import obj_file
from antumbra.formats.text_numbers import parsed_numbers
from antumbra.scene.materials import BLEND, MASK, OPAQUE, PINK
from gltf_files import png
from strength import examples


def put(folder, name, content):
    (folder / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return folder / name


# --- Numbers ----------------------------------------------------------------------------------------------------------


DIGITS = st.text("0123456789", min_size=1, max_size=30)
DECIMALS = st.builds(
    "{}{}.{}{}".format,
    st.sampled_from(["", "-", "+"]),
    DIGITS,
    st.one_of(st.just("0"), DIGITS),
    st.one_of(st.just(""), st.builds("{}{}".format, st.sampled_from("eE"), st.integers(-330, 330))),
)


@examples(300)
@given(st.lists(st.one_of(st.floats(allow_nan=False).map(repr), DECIMALS), min_size=1, max_size=20))
@example(["9007199254740993", "2.2250738585072011e-308", "1e23", "0.1", "179769313486231580793e289", "-0.0"])
def test_numbers_are_rounded_as_python_rounds_them(words):
    values = parsed_numbers(" ".join(words).encode(), np.float64)
    assert values.tobytes() == np.array([float(word) for word in words]).tobytes()


@pytest.mark.parametrize("text", ["1 2 x", "1 2 # three", "1,2", "one"])
def test_other_words_are_noticed(text):
    assert parsed_numbers(text.encode(), np.float64) is None


# --- Faces ------------------------------------------------------------------------------------------------------------


def parsed(text):
    """{material: [(position, uv or None, normal or None) of three corners]}, in the order of first use."""
    rows, meshes, material = {"v": [], "vt": [], "vn": []}, {}, None
    for line in text.splitlines():
        word, *rest = line.split() or [""]
        if word in rows:
            rows[word].append([float(number) for number in rest])
        elif word == "usemtl":
            material = rest[0]
        elif word == "f":
            corners = []
            for token in rest:
                indices = [int(index) if index else None for index in (token + "//").split("/")[:3]]
                corners.append(
                    [
                        None if i is None else rows[kind][i - 1 if i > 0 else i]
                        for kind, i in zip(("v", "vt", "vn"), indices)
                    ]
                )
            fans = [(corners[0], corners[k], corners[k + 1]) for k in range(1, len(corners) - 1)]
            meshes.setdefault(material, []).extend(fans)
    return meshes


STYLES = "{0}", "{0}/{1}", "{0}//{2}", "{0}/{1}/{2}"


@st.composite
def obj_texts(draw):
    """Text of an OBJ file whose lines come in any order."""
    lines, n = [], [0, 0, 0]
    kinds = st.sampled_from(["v", "v", "vt", "vn", "f", "f", "usemtl"])
    for kind in ["v", "v", "v", "vt", "vn", *draw(st.lists(kinds, max_size=25))]:
        if kind == "usemtl":
            lines.append("usemtl " + draw(st.sampled_from("abc")))
        elif kind == "f":
            style, corners = draw(st.sampled_from(STYLES)), draw(st.integers(3, 6))
            index = lambda count: st.integers(-count, count).filter(bool)
            tokens = [style.format(*(draw(index(count)) for count in n)) for _ in range(corners)]
            lines.append("f " + " ".join(tokens))
        else:
            k = ("v", "vt", "vn").index(kind)
            n[k] += 1
            numbers = draw(st.lists(st.integers(-9, 9), min_size=2 + (k != 1), max_size=2 + (k != 1)))
            lines.append(" ".join([kind, *(f"{number / 4}" for number in numbers)]))
    return "\n".join([*lines, "f 1 2 3", ""])


def disguised(text, draw_from):
    """The same file in other white space, with comments."""
    text = text.replace(" ", draw_from([" ", "  ", "\t"])).replace("\n", draw_from(["\n", "\r\n", " \n\n ", "\n# c\n"]))
    return draw_from(["", "# a comment\n", "\n\n"]) + text + draw_from(["", " ", "g group\ns off\nl 1 2\n"])


@examples(150)
@given(text=obj_texts(), data=st.data())
def test_meshes_equal_those_of_a_parser_of_lines(tmp_path_factory, text, data):
    path = put(
        tmp_path_factory.mktemp("obj"), "a.obj", disguised(text, lambda forms: data.draw(st.sampled_from(forms)))
    )
    check_meshes(path, text)


def check_meshes(path, text):
    """Compare a file with what the parser of lines finds in `text`; return which attributes the meshes have."""
    wanted = list(parsed(text).values())[::-1]  # the last material comes first
    source, notes = obj_file.read_obj(path)
    pieces = list(source.pieces(0.0))
    assert not notes and len(pieces) == len(wanted)
    for piece, triangles in zip(pieces, wanted):
        np.testing.assert_array_equal(
            piece.vertices[0][piece.faces], [[corner[0] for corner in triangle] for triangle in triangles]
        )
        corners = [tuple(map(str, corner)) for triangle in triangles for corner in triangle]
        has_uv, has_normals = ("None" not in [corner[k] for corner in corners] for k in (1, 2))
        if has_normals:
            normals = [[corner[2] for corner in triangle] for triangle in triangles]
            np.testing.assert_array_equal(piece.look.normals[piece.faces], normals)
        assert has_normals == (piece.look is not None)
        if not has_uv and not has_normals:  # corners of equal vertices are one vertex, at least
            assert piece.vertices.shape[1] <= text.count("v ")
    return [piece.look is not None for piece in pieces]


@pytest.mark.parametrize("style", STYLES)
def test_each_form_of_corners(tmp_path, style):
    rows = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 1\nvn 0 0 1\nvn 0 1 0\n"
    text = rows + "f " + " ".join(style.format(k, 1, -1 - k % 2) for k in (1, 2, 3, -1)) + "\n"
    assert check_meshes(put(tmp_path, "a.obj", text), text) == ["{2}" in style]
    text += "usemtl a\nf 1//1 2/1/2 3 4/1\n"
    assert check_meshes(put(tmp_path, "a.obj", text), text) == [False, "{2}" in style]


def test_corners_share_vertices_that_agree_in_all_indices(tmp_path):
    put(tmp_path, "m.mtl", "newmtl m\nmap_Kd t.png\n")
    put(tmp_path, "t.png", png(np.random.default_rng(0).integers(0, 256, (4, 4, 3))))
    square = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n" + "vt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nvt 0.5 0.5\n"
    for faces, n in (("f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n", 4), ("f 1/1 2/2 3/3\nf 1/5 3/3 4/4\n", 5)):
        (piece,) = obj_file.read_obj(put(tmp_path, "a.obj", square + "usemtl m\n" + faces))[0].pieces(0.0)
        assert piece.vertices.shape == (1, n, 3) and piece.look.uv.shape == (n, 2)
        uv = np.array([(0, 1), (1, 1), (1, 0), (0, 0), (0.5, 0.5)], np.float32)  # v points down
        rows = [int(token.split("/")[1]) - 1 for token in faces.replace("f", "").split()]
        np.testing.assert_array_equal(piece.look.uv[piece.faces], uv[rows].reshape(-1, 3, 2))


def test_lines_continue_after_a_backslash(tmp_path):
    path = put(tmp_path, "a.obj", "v 0 0 \\\n 0\nv 1 0 0\nv 0 1 0\nf 1 2\\\r\n 3\n")
    assert load(path).n_triangles == 1


def test_colours_of_vertices(tmp_path):
    lines = ["v 0 0 0 1 0 0", "v 1 0 0 0 0.5 0", "v 0 1 0 0 0 2"]
    scene = load(put(tmp_path, "a.obj", "\n".join([*lines, "f 1 2 3\n"])))
    expected = [[1, 0, 0], [0, 0.21586053, 0], [0, 0, 1]]  # sRGB in bytes: 0.5 is 128
    np.testing.assert_allclose(scene.appearance.colours[0, :, :3], expected, rtol=1e-6)
    lines[1] = "v 1 0 0"
    assert load(put(tmp_path, "b.obj", "\n".join([*lines, "f 1 2 3\n"]))).appearance is None


def test_an_obj_needs_no_trimesh(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "trimesh", None)
    assert load(put(tmp_path, "a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")).n_triangles == 1


# --- Materials --------------------------------------------------------------------------------------------------------


def materials_of(tmp_path, text):
    put(tmp_path, "m.mtl", text)
    files = obj_file.SideFiles(tmp_path, "a.obj")
    return obj_file.read_materials(["m.mtl"], files), files.notes


@pytest.mark.parametrize(
    "lines, factor, mode",
    [
        ("", (1, 1, 1, 1), OPAQUE),
        ("Kd 0.123 0.5 1.5", (0.123, 0.5, 1, 1), OPAQUE),
        ("Kd 0.25", (0.25, 0.25, 0.25, 1), OPAQUE),
        ("  KD 0 0 0 \nNs 3", (0, 0, 0, 1), OPAQUE),
        ("Kd spectral a.rfl", (1, 1, 1, 1), OPAQUE),
        ("d 0.5", (1, 1, 1, 0.5), BLEND),
        ("d -halo 0.25", (1, 1, 1, 0.25), BLEND),
        ("Tr 0.25", (1, 1, 1, 0.75), BLEND),
        ("Tr 0.25\nd 1", (1, 1, 1, 1), OPAQUE),
    ],
)
def test_colour_and_opacity(tmp_path, lines, factor, mode):
    materials, notes = materials_of(tmp_path, f"newmtl other\nKd 0.9 0.9 0.9\nnewmtl two  words\n{lines}\n")
    material = materials["two words"]
    assert material.factor == factor and material.alpha_mode == mode and material.texture is None and not notes
    assert material.name == "two words" and len(materials) == 2


def test_textures_and_opacity_maps(tmp_path):
    pixels = np.random.default_rng(0).integers(0, 256, (4, 4, 3))
    put(tmp_path, "t.png", png(pixels))
    put(tmp_path, "o.png", png(np.full((4, 4), 70)))
    text = "newmtl a\nmap_Kd -s 1 1 1 t.png\nnewmtl b\nmap_d o.png\nnewmtl c\nmap_Kd t.png\nmap_d o.png\n"
    materials, notes = materials_of(tmp_path, text)
    a, b, c = (materials[name].texture for name in "abc")
    assert not notes and [materials[name].alpha_mode for name in "abc"] == [OPAQUE, MASK, MASK]
    np.testing.assert_array_equal(a.pixels[..., :3], pixels)
    assert (a.pixels[..., 3] == 255).all() and (b.pixels == (255, 255, 255, 70)).all()
    np.testing.assert_array_equal(c.pixels, np.dstack([pixels, np.full((4, 4), 70)]))


def test_unusable_textures_are_pink_with_one_note_each(tmp_path):
    put(tmp_path, "bad.png", b"\x89PNG but no more")
    text = "newmtl a\nmap_Kd bad.png\nnewmtl b\nmap_Kd bad.png\nmap_d gone.png\nnewmtl c\nmap_Kd gone.png\n"
    materials, notes = materials_of(tmp_path, text)
    assert all(materials[name].texture is None for name in "abc") and len(notes) == 2
    assert all(materials[name].factor[:3] == PINK for name in "abc")
    assert "'gone.png'" in notes[0] and "texture 'bad.png' is unusable" in notes[1]


def test_names_in_another_encoding(tmp_path):
    put(tmp_path, "m.mtl", "newmtl caf\xe9\nKd 1 0 0\nnewmtl b\n".encode("cp1252"))
    text = "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl caf\xe9\nf 1 2 3\nusemtl b\nf 1 3 2\n"
    scene = load(put(tmp_path, "a.obj", text.encode("cp1252")))
    assert [mesh.name for mesh in scene.meshes] == ["b", "café"] and scene.colours.tolist() == [[1, 1, 1], [1, 0, 0]]


# --- Emission, normal maps, metalness and roughness -------------------------------------------------------------------


def obj_with(folder, lines):
    (folder / "m.mtl").write_text("newmtl a\n" + lines)
    (folder / "a.obj").write_text(
        "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl a\nf 1/1 2/2 3/3\n"
    )
    (folder / "n.png").write_bytes(png(np.full((2, 2, 3), (128, 128, 255), np.uint8)))
    return load(folder / "a.obj")


def test_mtl_files_have_emission_normal_maps_metalness_and_roughness(tmp_path):
    scene = obj_with(tmp_path, "Kd 1 1 1\nKe 2 0.5 0\nmap_Ke n.png\nnorm -bm 0.25 n.png\nPm 0.75\nPr 0.5\n")
    (pbr,) = scene.appearance.pbr
    assert (pbr.metallic, pbr.roughness, pbr.normal_scale, pbr.emission) == (0.75, 0.5, 0.25, (2.0, 0.5, 0.0))
    assert pbr.normal_map.texture.holds_data and not pbr.emission_map.texture.holds_data
    assert scene.notes == () and scene.appearance.hands.tolist() == [1.0]


def test_a_map_of_emission_alone_shines_as_it_is(tmp_path):
    (pbr,) = obj_with(tmp_path, "map_Ke n.png\n").appearance.pbr
    assert pbr.emission == (1.0, 1.0, 1.0)


def test_materials_without_these_are_diffuse(tmp_path):
    assert obj_with(tmp_path, "Kd 0.5 0.5 0.5\nKe 0 0 0\nKs 1 1 1\nNs 50\n").appearance is None


def test_unread_maps_are_noted(tmp_path):
    with pytest.warns(UserWarning, match="left out"):
        scene = obj_with(tmp_path, "Kd 1 1 1\nmap_bump n.png\nmap_Pr n.png\nnorm gone.png\n")
    notes = " ".join(scene.notes)
    assert "left out: bump maps, maps of metalness and roughness" in notes and "'gone.png'" in notes
