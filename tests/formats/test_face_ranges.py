"""Binary PLY and STL files are stored range by range, with the bytes of the scene in memory."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.scene_reading import read_scene_data
from antumbra.formats import face_ranges
from antumbra.formats.face_ranges import FileRows
from antumbra.formats.mesh_files import spans_of_mesh_file
from antumbra.formats.scene_format import ReadOptions
from antumbra.scene.scene_bounds import sampled_faces
from antumbra.scene.streamed_data import StreamedData
from bvh_scenes import scattered
from formats.test_mesh_files import put, stl_binary

RNG = np.random.default_rng(8)
N_VERTICES, N_FACES = 400, 901
VERTICES = RNG.normal(size=(N_VERTICES, 3))
FACES = RNG.integers(0, N_VERTICES - 20, (N_FACES, 3))  # the last vertices are unused, and beyond all others
VERTICES[-20:] += 100.0
COLOURS = {channel: RNG.integers(0, 256, N_VERTICES + N_FACES).astype("u1") for channel in ("red", "green", "blue")}


def ply(order="<", kind="f4", index="i4", of="", normals=False, offset=0.0, faces=FACES, vertices=VERTICES):
    """A binary PLY file; `of`: what has colours, "vertex" or "face"."""
    names = {"f4": "float", "f8": "double", "i4": "int", "u4": "uint", "u1": "uchar"}
    colours = [(channel, "u1") for channel in COLOURS]
    axes = [(axis, order + kind) for axis in "xyz"] + [(f"n{axis}", order + "f4") for axis in "xyz" if normals]
    vertex = np.zeros(len(vertices), axes + colours * (of == "vertex"))
    face = np.zeros(len(faces), [("n", "u1"), ("corners", order + index, 3), *(colours * (of == "face"))])
    for k, axis in enumerate("xyz"):
        vertex[axis] = vertices[:, k] + offset
        if normals:
            vertex[f"n{axis}"] = vertices[:, 2 - k]
    face["n"], face["corners"] = 3, faces
    for channel, values in COLOURS.items():
        if of:
            rows = vertex if of == "vertex" else face
            rows[channel] = values[: len(rows)]
    head = [f"ply\nformat binary_{'little' if order == '<' else 'big'}_endian 1.0", f"element vertex {len(vertices)}"]
    head += [f"property {names[vertex.dtype[name].str[1:]]} {name}" for name in vertex.dtype.names]
    head += [f"element face {len(faces)}", f"property list uchar {names[index]} vertex_indices"]
    head += [f"property uchar {channel}" for channel in COLOURS if of == "face"]
    return "\n".join([*head, "end_header\n"]).encode() + vertex.tobytes() + face.tobytes()


def stl(triangles=300):
    facets = np.zeros(triangles, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    facets["corners"] = scattered(triangles)
    return bytes(80) + triangles.to_bytes(4, "little") + facets.tobytes()


FILES = {
    "floats.ply": ply(),
    "doubles.ply": ply(kind="f8"),
    "doubles that are floats.ply": ply(kind="f8", vertices=VERTICES.round(2) // 0.25),
    "whole numbers.ply": ply(kind="i4", vertices=VERTICES * 1000),
    "map coordinates.ply": ply(kind="f8", offset=448262.5),
    "rounded map coordinates.ply": ply(offset=448262.5),
    "big endian.ply": ply(">", index="u4"),
    "colours of faces.ply": ply(of="face"),
    "colours of vertices.ply": ply(of="vertex"),
    "normals.ply": ply(normals=True, of="vertex"),
    "high.ply": ply(vertices=VERTICES * 3000),
    "soup.stl": stl(),
    "solid.stl": stl_binary(),
}


@pytest.fixture
def small_ranges(monkeypatch):
    """Ranges, spans and reads so small that small files have many."""
    monkeypatch.setattr(face_ranges, "FACES_PER_PIECE", 47)
    monkeypatch.setattr(face_ranges, "PIECES_PER_SPAN", 3)
    monkeypatch.setattr(face_ranges, "_WINDOW", 600)
    monkeypatch.setattr(face_ranges, "_GAP", 30)


def streamed(path):
    return read_scene_data(path, ReadOptions(streamed=True))


@pytest.mark.parametrize("name", FILES)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_store_of_ranges_has_the_bytes_of_the_scene_in_memory(tmp_path, small_ranges, name):
    path, whole = put(tmp_path, name, FILES[name]), tmp_path / "whole.antumbra"
    scene, data = at.load(path), streamed(path)
    assert isinstance(data, StreamedData) and not data.resident and hasattr(data.source, "piece_of")
    assert data.notes == scene.notes and data.up == scene.up and data.bounds.tolist() == scene.bounds.tolist()
    at.build_store(scene, whole, chunk=64)
    at.build_store(path, tmp_path / "a.antumbra", chunk=64)
    assert (tmp_path / "a.antumbra").read_bytes() == whole.read_bytes()
    assert scene.n_triangles == at.load(whole).n_triangles and at.load(whole).notes[: len(scene.notes)] == scene.notes


def test_the_cases_have_what_they_are_named_after(tmp_path, small_ranges):
    data = {name: streamed(put(tmp_path, name, content)) for name, content in FILES.items()}
    assert {name for name, each in data.items() if each.has_looks} == {"colours of vertices.ply", "normals.ply"}
    assert "rounded to steps" in "".join(data["rounded map coordinates.ply"].notes)
    assert "pass its own" in "".join(data["high.ply"].notes)
    assert data["floats.ply"].bounds.max() < 50.0  # without the unused vertices


def test_spans_are_the_pieces_in_order(tmp_path, small_ranges):
    path = put(tmp_path, "a.ply", FILES["colours of faces.ply"])
    source = streamed(path).source
    pieces, spans = list(source.pieces(0.0)), [list(source.span(k)) for k in range(source.n_spans)]
    assert source.n_spans == spans_of_mesh_file(path) == 7 and [*map(len, spans)] == [3] * 6 + [2]
    for piece, other in zip(pieces, [piece for span in spans for piece in span], strict=True):
        assert np.array_equal(piece.vertices, other.vertices) and np.array_equal(piece.faces, other.faces)
        assert np.array_equal(piece.colour, other.colour)
    assert spans_of_mesh_file(put(tmp_path, "b.stl", b"solid a\nendsolid a\n")) == 1


def test_a_sample_of_faces_is_that_of_the_scene_in_memory(tmp_path, small_ranges, monkeypatch):
    monkeypatch.setattr("antumbra.scene.scene_bounds.MAX_SAMPLED_FACES", 100)
    path = put(tmp_path, "a.ply", ply(kind="f8"))
    samples = sampled_faces(at.load(path).source, N_FACES), streamed(path).sampled_faces()
    assert samples[0].shape == (91, 3, 3) and np.array_equal(*samples)


@pytest.mark.parametrize("window, gap", [(1, 1), (64, 8), (64, 200), (1 << 24, 1 << 12)])
def test_any_rows_of_a_file_are_read(tmp_path, monkeypatch, window, gap):
    monkeypatch.setattr(face_ranges, "_WINDOW", window)
    monkeypatch.setattr(face_ranges, "_GAP", gap)
    values = RNG.random(500)
    rows = FileRows(put(tmp_path, "a.bin", b"head" + values.tobytes()), np.dtype("f8"), 4)
    for numbers in ([7], [0, 1, 2, 499], range(500), np.flatnonzero(values > 0.7)):
        chosen = np.array(numbers)
        assert np.array_equal(rows[chosen], values[chosen])


@pytest.mark.parametrize(
    "content, words",
    [
        (ply(vertices=np.where(np.arange(N_VERTICES)[:, None] == 333, np.nan, VERTICES)), "vertex 333 is (nan, nan"),
        (ply(faces=np.where(np.arange(N_FACES)[:, None] == 777, N_VERTICES, FACES)), "face 777 uses vertex 400"),
        (ply()[:-3], "cut short"),
    ],
)
def test_damage_is_named_as_in_memory(tmp_path, small_ranges, content, words):
    path = put(tmp_path, "a.ply", content)
    with pytest.raises(at.InputError) as caught:
        at.build_store(path, tmp_path / "a.antumbra")
    assert words in str(caught.value) and "\n" not in str(caught.value)
    assert [each.name for each in tmp_path.iterdir()] == ["a.ply"]


def test_faces_of_four_corners_among_thinner_ones_are_refused(tmp_path):
    content = bytearray(ply())
    content[-2 * 13] = 4  # as long as a file of triangles
    content[-13] = 2
    with pytest.raises(at.InputError, match=r"a\.ply: face 899 has 4 corners; triangulate the mesh"):
        at.build_store(put(tmp_path, "a.ply", bytes(content)), tmp_path / "a.antumbra")


def test_a_file_that_shrinks_is_refused(tmp_path):
    path = put(tmp_path, "a.ply", ply())
    source = streamed(path).source
    path.write_bytes(path.read_bytes()[:-2000])
    with pytest.raises(at.InputError, match="was cut short while it was read"):
        list(source.pieces(0.0))


def test_a_streamed_scene_has_no_triangles_in_memory(tmp_path):
    data = streamed(put(tmp_path, "a.ply", ply()))
    for ask in (data.triangles, lambda: data.object_of_face):
        with pytest.raises(at.InputError, match="never all in memory"):
            ask()
    assert data.n_triangles == N_FACES and not data.animated


@pytest.mark.parametrize("suffix", ["obj", "glb"])
def test_other_meshes_are_read_whole_and_stored_alike(tmp_path, suffix):
    from antumbra.formats.format_registry import write_scene
    from antumbra.generate.procedural_scenes import generate

    write_scene(generate("atrium", 2000, 0), "atrium", tmp_path / f"a.{suffix}")
    at.build_store(at.load(tmp_path / f"a.{suffix}"), tmp_path / "whole.antumbra", chunk=64)
    at.build_store(tmp_path / f"a.{suffix}", tmp_path / "b.antumbra", chunk=64)
    assert (tmp_path / "b.antumbra").read_bytes() == (tmp_path / "whole.antumbra").read_bytes()
