"""Folders of vertex arrays, one array for each frame."""

import json
import pickle

import numpy as np
import pytest

from antumbra.base.errors import InputError
from antumbra.engine.scene_loading import load
from gltf_files import TETRAHEDRON, TETRAHEDRON_FACES, assert_at

SHIFTS = np.array([[0, 0, 0], [4, 0, 0], [4, 8, 0]], np.float32)
FRAMES = TETRAHEDRON[None] + SHIFTS[:, None]


def write(folder, frames=FRAMES, faces=TETRAHEDRON_FACES, info=None, rgba=None):
    folder.mkdir(exist_ok=True)
    np.save(folder / "frames.npy", frames)
    np.save(folder / "faces.npy", faces)
    if info is not None:
        (folder / "info.json").write_text(json.dumps(info))
    if rgba is not None:
        np.save(folder / "face_rgba.npy", rgba)
    return folder


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "walk"


@pytest.mark.parametrize("dtype", ["<f4", ">f4", "<f8"])
def test_straight_lines_between_frames(folder, dtype):
    scene = load(write(folder, FRAMES.astype(dtype), info={"times": [10.0, 11.0, 15.0]}))
    assert (scene.name, scene.duration, scene.n_triangles) == ("walk", 5.0, 4)
    for time, shift in [
        (0, (0, 0, 0)),
        (0.25, (1, 0, 0)),
        (1, (4, 0, 0)),
        (3, (4, 4, 0)),
        (5, (4, 8, 0)),
        (9, (4, 8, 0)),
    ]:
        assert_at(scene, TETRAHEDRON[TETRAHEDRON_FACES] + np.array(shift, float), time)
    np.testing.assert_array_equal(scene.bounds, [[0, 0, 0], [1, 1, 1]])


def test_frames_themselves_are_exact(folder):
    frames = np.random.default_rng(0).normal(size=(5, 4, 3)).astype(np.float32)
    scene = load(write(folder, frames, info={"times": [0.0, 0.1, 0.3, 0.7, 1.9]}))
    for frame, time in zip(frames, [0.0, 0.1, 0.3, 0.7, 1.9]):
        expected = (frame.astype(float)[TETRAHEDRON_FACES] - scene.origin).astype(np.float32)
        np.testing.assert_array_equal(scene.triangles(time).vertices, expected)


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64, ">f4"])
def test_between_frames_float64_decides_and_is_rounded_once(folder, dtype):
    frames = np.random.default_rng(1).normal(size=(2, 40_000, 3)).astype(dtype)
    faces = np.random.default_rng(2).integers(0, 40_000, (30_000, 3))
    scene = load(write(folder, frames, faces, info={"times": [0.0, 3.0]}))
    a, b = frames.astype(float)
    mixed = (1.0 - 0.7 / 3.0) * a + 0.7 / 3.0 * b
    expected = (mixed[faces] - scene.origin).astype(np.float32)
    for threads in (1, 3):
        np.testing.assert_array_equal(scene.triangles(0.7, threads).vertices, expected)


def test_times_from_words_or_24_frames_a_second(folder):
    assert load(write(folder)).duration == 2 / 24
    scene = load(write(folder, info={"frames": "40 frames (float32), t=37.000..41.875; most move"}))
    assert scene.duration == 4.875
    assert_at(scene, FRAMES[1][TETRAHEDRON_FACES], 4.875 / 2)
    assert load(write(folder, info={"frames": "some"})).duration == 2 / 24
    assert load(write(folder, FRAMES[:1], info={"frames": "t=1..2"})).duration == 0.0


def test_face_colours_are_linear(folder):
    rgba = np.array([[255, 0, 51, 255], [0, 0, 0, 0], [10, 20, 30, 255], [1, 2, 3, 4]], np.uint8)
    np.testing.assert_allclose(load(write(folder, rgba=rgba)).colours, rgba[:, :3] / 255.0, rtol=1e-6)
    floats = rgba / np.float32(255)
    np.testing.assert_array_equal(load(write(folder, rgba=floats)).colours, floats[:, :3])
    assert (load(write(folder.with_name("plain"))).colours == 1).all()


def test_fortran_order_and_vertices_out_of_use(folder):
    frames = np.concatenate([np.full((3, 2, 3), np.nan, np.float32), FRAMES], axis=1)
    scene = load(write(folder, np.asfortranarray(frames), TETRAHEDRON_FACES.astype(np.uint32) + np.uint32(2)))
    assert_at(scene, FRAMES[2][TETRAHEDRON_FACES], 1.0)


def test_frames_are_read_when_a_time_asks_for_them(folder):
    frames = FRAMES.copy()
    frames[2, 3, 1] = np.inf
    scene = load(write(folder, frames, info={"times": [0, 1, 2]}))
    assert scene.triangles(1.0).vertices.shape == (4, 3, 3)
    with pytest.raises(InputError, match=r"walk/frames.npy frame 2: vertex 3"):
        scene.triangles(1.5)


def _save_objects(folder):
    with (folder / "frames.npy").open("wb") as stream:
        np.save(stream, np.array([[[{}] * 3]], object), allow_pickle=True)


def _npy_header(text: str, data=b"") -> bytes:
    body = text.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + len(body).to_bytes(2, "little") + body + data


HUGE = "{'descr': '<f4', 'fortran_order': False, 'shape': (1000000, 1000000, 3)}"
WRONG = {
    "no frames": (lambda f: (f / "frames.npy").unlink(), "without frames.npy"),
    "no faces": (lambda f: (f / "faces.npy").unlink(), "without faces.npy"),
    "objects": (_save_objects, "frames.npy holds object"),
    "a pickle": (
        lambda f: (f / "frames.npy").write_bytes(pickle.dumps([1, 2])),
        "frames.npy: not a numpy array",
    ),
    "empty file": (lambda f: (f / "faces.npy").write_bytes(b""), "faces.npy: the file is empty"),
    "declared larger than the file": (
        lambda f: (f / "frames.npy").write_bytes(_npy_header(HUGE)),
        "frames.npy says 12000000000000 bytes",
    ),
    "negative shape": (
        lambda f: (f / "frames.npy").write_bytes(_npy_header(HUGE.replace("(1000000,", "(-1,"))),
        "frames.npy has shape",
    ),
    "bad header": (lambda f: (f / "frames.npy").write_bytes(_npy_header("{'descr': ")), "not a numpy array"),
    "truncated": (
        lambda f: (f / "frames.npy").write_bytes((f / "frames.npy").read_bytes()[:-5]),
        "frames.npy says 144 bytes of data, but has 139",
    ),
    "flat frames": (lambda f: np.save(f / "frames.npy", FRAMES[0]), "frames.npy is float32 (4, 3)"),
    "no frame": (lambda f: np.save(f / "frames.npy", FRAMES[:0]), "frames.npy is float32 (0, 4, 3)"),
    "whole numbers": (lambda f: np.save(f / "frames.npy", FRAMES.astype(int)), "frames.npy is int64"),
    "NaN": (lambda f: np.save(f / "frames.npy", FRAMES * np.nan), "frames.npy frame 0: vertex 0"),
    "index out of range": (lambda f: np.save(f / "faces.npy", TETRAHEDRON_FACES + 1), "faces.npy: face"),
    "float faces": (
        lambda f: np.save(f / "faces.npy", TETRAHEDRON_FACES * 1.0),
        "faces.npy: faces must be whole",
    ),
    "flat faces": (lambda f: np.save(f / "faces.npy", np.arange(6)), "faces.npy: faces must be whole"),
    "one face": (lambda f: np.save(f / "faces.npy", np.int64(3)), "faces.npy: faces must be whole"),
    "no face": (lambda f: np.save(f / "faces.npy", TETRAHEDRON_FACES[:0]), "no triangles"),
    "too few colours": (lambda f: np.save(f / "face_rgba.npy", np.zeros((3, 4), np.uint8)), "face_rgba.npy"),
    "colours of another type": (
        lambda f: np.save(f / "face_rgba.npy", np.zeros((4, 4), int)),
        "face_rgba.npy is int64",
    ),
    "info is no JSON": (lambda f: (f / "info.json").write_text("{"), "info.json: not JSON"),
    "info is a list": (lambda f: (f / "info.json").write_text("[]"), "info.json: must be a JSON object"),
    "too few times": (
        lambda f: (f / "info.json").write_text('{"times": [0, 1]}'),
        '"times" must be a list of 3',
    ),
    "times of text": (
        lambda f: (f / "info.json").write_text('{"times": ["a", 1, 2]}'),
        '"times" must be a list of 3',
    ),
    "times go back": (lambda f: (f / "info.json").write_text('{"times": [0, 2, 1]}'), "info.json: the times"),
    "words go back": (lambda f: (f / "info.json").write_text('{"frames": "t=5..1"}'), "info.json: the times"),
    "words of no number": (
        lambda f: (f / "info.json").write_text('{"frames": "t=1.2.3..4"}'),
        "info.json: the times",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_bad_folders(folder, case):
    spoil, words = WRONG[case]
    spoil(write(folder))
    with pytest.raises(InputError) as caught:
        load(folder)
    message = str(caught.value)
    assert words in message and message.startswith("walk") and "\n" not in message
