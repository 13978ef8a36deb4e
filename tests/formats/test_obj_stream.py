"""OBJ files are stored part by part, with the bytes of the scene in memory."""

import os
import tempfile

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.scene_reading import read_scene_data
from antumbra.formats import obj_stream
from antumbra.formats.scene_format import ReadOptions
from formats.test_mesh_files import put
from gltf_files import png

RNG = np.random.default_rng(3)
N = 60


def lines_of(kind, rows):
    return [" ".join([kind, *map(repr, row)]) for row in rows.round(4).tolist()]


V = lines_of("v", RNG.normal(size=(N, 3)))
COLOURED = lines_of("v", np.concatenate([RNG.normal(size=(N, 3)), RNG.random((N, 3))], 1))
VT, VN = lines_of("vt", RNG.random((20, 2))), lines_of("vn", RNG.normal(size=(10, 3)))
CORNERS = [RNG.choice(N, n, replace=False) + 1 for n in RNG.integers(3, 6, 80)]


def faces(text="{0}", corners=CORNERS):
    return ["f " + " ".join(text.format(v, v % 20 + 1, v % 10 + 1) for v in each.tolist()) for each in corners]


def with_materials():
    out = ["mtllib m.mtl"]
    for k, face in enumerate(faces("{0}/{1}")):
        out += [f"usemtl {('red', 'wood', 'nothing')[k // 7 % 3]}"] * (k % 7 == 0) + [face]
    return [*V, *VT, *out]


BACK = [f"v {k} {k % 3} 0\nv {k} 1 {k % 5}\nv 1 {k} 2\nf -3 -2 -1" for k in range(30)]
FILES = {
    "faces": [*V, *faces()],
    "vertices after faces": [*faces(), *V],
    "vertex colours": [*COLOURED, *faces()],
    "normals": [*V, *VN, *faces("{0}//{2}")],
    "dangling": [*V, *faces("{0}/{1}")],
    "materials": with_materials(),
    "some faces with texture coordinates": [*V, *VT, "mtllib m.mtl", "usemtl wood", *faces("{0}/{1}")[:40], *faces()],
    "counted back": BACK,
    "odd lines": [
        *V,
        "g a",
        "# comment",
        "frob 1",
        *faces()[:40],
        "f 1 2",
        "",
        "frobs 2",
        "f 1 2 \\\n 3",
        *faces()[40:],
    ],
    "other line ends": ["\r\n".join([*V, "f 1 2 \\\r\n 3", *faces(), ""])],
    "tabs": [line.replace(" ", " \t") for line in (*V, *faces())],
    "no line end": [*V, *faces()],
}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with materials; parts and pieces are so small that small files have many."""
    monkeypatch.setattr(obj_stream, "_PART", 300)
    monkeypatch.setattr(obj_stream, "FACES_PER_PIECE", 7)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "scratch"))
    (tmp_path / "scratch").mkdir()
    (tmp_path / "t.png").write_bytes(png(RNG.integers(0, 256, (4, 4, 3))))
    put(tmp_path, "m.mtl", "newmtl red\nKd 1 0 0\nnewmtl wood\nKd 1 1 1\nmap_Kd t.png\n")
    return tmp_path


def streamed(path):
    return read_scene_data(path, ReadOptions(streamed=True))


@pytest.mark.parametrize("name", [each for each in FILES if each != "normals"])  # see test_stored_looks
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_store_of_parts_has_the_bytes_of_the_scene_in_memory(folder, name):
    text = "\n".join(FILES[name]) + "\n" * (name != "no line end")
    path = put(folder, "a.obj", text)
    scene, data = at.load(path), streamed(path)
    assert isinstance(data.source, obj_stream.ObjStream) and data.notes == scene.notes
    assert len(list(data.source.pieces(0.0))) > 3
    at.build_store(scene, folder / "whole.antumbra", chunk=64)
    at.build_store(path, folder / "a.antumbra", chunk=64)
    assert (folder / "a.antumbra").read_bytes() == (folder / "whole.antumbra").read_bytes()


def test_the_cases_have_what_they_are_named_after(folder):
    notes = {name: "".join(streamed(put(folder, "a.obj", "\n".join(FILES[name]))).notes) for name in FILES}
    assert "faces use texture coordinates that the file lacks" in notes["dangling"]
    assert "1 face with fewer than 3 corners" in notes["odd lines"]
    assert "left out 2 lines of unknown words; line 63 begins with 'frob'" in notes["odd lines"]


def test_scratch_files_are_removed(folder):
    data = streamed(put(folder, "a.obj", "\n".join(FILES["materials"])))
    assert len(os.listdir(folder / "scratch")) == 1
    del data
    assert os.listdir(folder / "scratch") == []


@pytest.mark.parametrize("lines", [[*V, *COLOURED, *faces()], V])
def test_other_files_are_read_whole(folder, lines):
    assert obj_stream.stream_obj(put(folder, "a.obj", "\n".join(lines))) is None
    assert os.listdir(folder / "scratch") == []


@pytest.mark.parametrize(
    "line, words",
    [
        ("f 1 2 0", "line 141 uses vertex 0"),
        ("f 1 2 999", "a face uses a missing vertex"),
        ("f a b c", "cannot be read"),
    ],
)
def test_damage_is_named_as_in_memory(folder, line, words):
    path, told = put(folder, "a.obj", "\n".join([*V, *faces(), line])), []
    for read in (at.load, streamed):
        with pytest.raises(at.InputError, match=words) as caught:
            read(path)
        told.append(str(caught.value))
    assert told[0] == told[1]
