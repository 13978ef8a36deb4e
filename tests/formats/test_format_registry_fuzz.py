"""Damaged files give a scene or an `InputError`, never another exception, a hang or a huge allocation."""

import base64
import io
import json
import os
import resource
import signal
import time
import tracemalloc
import warnings
import zlib
from contextlib import contextmanager

import hypothesis
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image
from PIL.PngImagePlugin import PngInfo

import city_files
from antumbra.base.errors import InputError
from antumbra.city.sensors.sensor_files import SUFFIXES as POINT_SUFFIXES
from antumbra.city.vegetation.vegetation_table import SUFFIXES as TREE_SUFFIXES
from antumbra.engine.scene_loading import load
from antumbra.engine.scene_reading import SCENE_SUFFIXES
from antumbra.formats.gltf.gltf_file import split_glb
from antumbra.scene.sky import ENVIRONMENT_SUFFIXES
from engine.test_scene_loading_frames import FRAMES
from formats.test_mesh_files import obj_text, ply_binary, ply_text, stl_binary, stl_text
from gltf_files import TETRAHEDRON_FACES, Gltf, everything
from reader_seeds import SEEDS
from repository import ROOT
from scenes import scene_path

SECONDS = 20  # for a file of a few kilobytes; only a hang takes so long
MEGABYTES = 64
ODD_VALUES = [
    None,
    True,
    -1,
    0,
    1,
    2,
    3,
    7,
    255,
    2**31,
    2**53,
    10**30,
    0.5,
    -0.0,
    1e38,
    1e308,
    "",
    "x",
    [],
    {},
    [0],
    [[]],
]


class Hang(BaseException):
    """Raised on a timeout. It is no `Exception`, so that no handler of the loader catches it."""


@contextmanager
def limits(trace=True):
    """Raise Hang after SECONDS (if the system has timers), and check, if `trace`, that no huge array was allocated."""

    def ring(*_):
        raise Hang

    timer = hasattr(signal, "setitimer")
    if timer:
        before = signal.signal(signal.SIGALRM, ring)
        signal.setitimer(signal.ITIMER_REAL, SECONDS)
    if trace:
        tracemalloc.start()
    try:
        yield
        assert not trace or tracemalloc.get_traced_memory()[1] < MEGABYTES << 20
    finally:
        tracemalloc.stop()
        if timer:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, before)


def outcome(path) -> str:
    """Load and evaluate a file; return "scene", or "error" after checking the error."""
    with limits(), warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        try:
            scene = load(path)
            for time in (0.0, scene.duration / 2):
                triangles = scene.triangles(time)
        except InputError as error:
            assert "\n" not in str(error) and len(str(error)) < 600
            # our own readers expect all errors; only trimesh's exceptions may reach the general handler
            assert "is the file damaged" not in str(error) or path.suffix in (".obj", ".ply", ".stl")
            return "error"
    assert triangles.vertices.shape == (scene.n_triangles, 3, 3) and scene.n_triangles > 0
    assert np.isfinite(triangles.vertices).all() and np.isfinite(scene.origin).all()
    assert ((triangles.colour >= 0) & (triangles.colour <= 1)).all()
    return "scene"


def damaged(data: bytes, rng) -> bytes:
    """The bytes after a few random changes: flipped, overwritten, cut out, doubled, or without the end."""
    data = bytearray(data)
    for _ in range(rng.integers(1, 4)):
        if not data:
            break
        a = int(rng.integers(len(data)))
        b = min(len(data), a + int(rng.integers(1, 16)))
        match rng.integers(6):
            case 0:
                data[a] ^= 1 << int(rng.integers(8))
            case 1:
                data[a:b] = rng.bytes(b - a)
            case 2:
                del data[a:b]
            case 3:
                data[a:a] = data[a:b]
            case 4:
                data[a:b] = bytes(rng.choice(np.frombuffer(b"0123456789-.e \n\xff\x00", np.uint8), b - a))
            case _:
                if rng.integers(4) == 0:
                    del data[a:]
    return bytes(data)


def with_odd_value(document, rng):
    """A copy of a JSON document with one value replaced, removed or doubled anywhere in it."""
    document = json.loads(json.dumps(document))
    places = []

    def walk(node):
        for key in node if isinstance(node, dict) else range(len(node)):
            places.append((node, key))
            if isinstance(node[key], (dict, list)):
                walk(node[key])

    walk(document)
    node, key = places[rng.integers(len(places))]
    match rng.integers(4):
        case 0:
            del node[key]
        case 1 if isinstance(node[key], (int, float)):
            node[key] = node[key] + int(rng.choice([-1, 1, 100, 10**9]))
        case 2 if isinstance(node, list):
            node.append(node[key])
        case _:
            node[key] = ODD_VALUES[rng.integers(len(ODD_VALUES))]
    return document


def run(path, base: bytes, seeds, change=damaged) -> dict:
    """Outcomes over seeds. On failure the message has the seed, and the file is kept at `path`."""
    counts = {"scene": 0, "error": 0}
    for seed in seeds:
        path.write_bytes(change(base, np.random.default_rng(seed)))
        try:
            counts[outcome(path)] += 1
        except BaseException as error:
            raise AssertionError(f"{path}, seed {seed}: {type(error).__name__}: {error}") from error
    return counts


COMPRESSED = ROOT / "tests" / "data" / "compressed"


def packed_gltf() -> bytes:
    """A file compressed by meshopt with its data in a URI, and without the fallback."""
    document = json.loads((COMPRESSED / "fallback.gltf").read_bytes())
    data = base64.b64encode((COMPRESSED / "fallback.bin").read_bytes()).decode()
    document["buffers"][0]["uri"] = "data:application/octet-stream;base64," + data
    del document["buffers"][1]["uri"]
    return json.dumps(document).encode()


def bases() -> dict[str, bytes]:
    return {
        "all.glb": everything().glb(),
        "all.gltf": everything().gltf(),
        "khr.glb": (COMPRESSED / "khr.glb").read_bytes(),
        "packed.gltf": packed_gltf(),
        "a.obj": obj_text().encode(),
        "a.ply": ply_text().encode(),
        "b.ply": ply_binary(),
        "a.stl": stl_binary(),
        "b.stl": stl_text().encode(),
        "a.city.json": json.dumps(city_files.everything()).encode(),
        "a.city.jsonl": city_files.sequence(city_files.everything()).encode(),
    }


def json_change(base: bytes, rng) -> bytes:
    return json.dumps(with_odd_value(json.loads(base), rng)).encode()


@pytest.mark.parametrize("name", bases())
def test_undamaged(tmp_path, name):
    (tmp_path / name).write_bytes(bases()[name])
    assert outcome(tmp_path / name) == "scene"


@pytest.mark.parametrize("name", bases())
def test_damaged_bytes(tmp_path, name):
    counts = run(tmp_path / name, bases()[name], range(100))
    assert counts["error"] > 5


@pytest.mark.parametrize("name", ["all.gltf", "packed.gltf", "a.city.json"])
def test_odd_json_values(tmp_path, name):
    counts = run(tmp_path / name, bases()[name], range(400), json_change)
    assert counts["error"] > 40 and counts["scene"] > 40


def frames_folder(folder):
    folder.mkdir()
    np.save(folder / "frames.npy", FRAMES)
    np.save(folder / "faces.npy", TETRAHEDRON_FACES)
    (folder / "info.json").write_text('{"times": [0, 1, 2], "frames": "t=0..2"}')
    return folder


@pytest.mark.parametrize("name", ["frames.npy", "faces.npy", "info.json"])
def test_damaged_frames(tmp_path, name):
    folder = frames_folder(tmp_path / "walk")
    good, counts = (folder / name).read_bytes(), {"scene": 0, "error": 0}
    for seed in range(80):
        (folder / name).write_bytes(damaged(good, np.random.default_rng(seed)))
        counts[outcome(folder)] += 1
    assert counts["error"] > 5


REAL = ["BoxAnimated.glb", "SimpleSkin.gltf", "SimpleMorph.gltf", "RiggedSimple.glb", "InterpolationTest.glb"]


@pytest.mark.parametrize("name", REAL)
def test_damaged_real_files(tmp_path, name):
    run(tmp_path / name, scene_path(f"gltf/{name}").read_bytes(), range(40))


@pytest.mark.slow
@pytest.mark.parametrize("name", bases())
def test_damaged_bytes_at_length(tmp_path, name):
    run(tmp_path / name, bases()[name], range(1000, 3000))


@pytest.mark.slow
def test_odd_json_values_at_length(tmp_path):
    run(tmp_path / "a.gltf", everything().gltf(), range(1000, 5000), json_change)


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [*REAL, "CesiumMan.glb", "AnimatedMorphCube.glb", "SimpleInstancing.glb", "Cameras.gltf"]
)
def test_damaged_real_files_at_length(tmp_path, name):
    run(tmp_path / name, scene_path(f"gltf/{name}").read_bytes(), range(1000, 1500))


def encoded(kind: str) -> bytes:
    """A small picture with an alpha, if the format has one."""
    if kind in ("ETC1S", "UASTC"):
        return (COMPRESSED / f"leaf-{kind.lower()}.ktx2").read_bytes()
    rng, stream = np.random.default_rng(0), io.BytesIO()
    pixels, mode, more = rng.integers(0, 256, (9, 14, 4)).astype(np.uint8), "RGB" if kind[:3] == "JPE" else "RGBA", {}
    if kind == "PNG palette":
        mode, more = "P", {"transparency": bytes(range(200))}
    elif kind == "JPEG progressive":
        more = {"progressive": True}
    elif kind == "TGA packed":
        more = {"compression": "tga_rle"}
    if kind[:3] == "PNG":
        more = {**more, "pnginfo": PngInfo()}
        more["pnginfo"].add_text("Comment", "harmless " * 50)
    source = Image.fromarray(pixels if mode == "RGBA" else pixels[..., :3])
    source.convert(mode).save(stream, kind.split(maxsplit=1)[0], **more)
    return stream.getvalue()


PICTURES = ["PNG", "PNG palette", "JPEG", "JPEG progressive", "WEBP", "BMP", "TGA", "TGA packed", "ETC1S", "UASTC"]


def cut_by(picture: bytes) -> bytes:
    """A GLB of a triangle that the picture's alpha cuts."""
    made = Gltf()
    texture = made.add("textures", source=made.add("images", bufferView=made.view(picture)))
    look = {"baseColorTexture": {"index": texture}}
    material = made.add("materials", alphaMode="MASK", pbrMetallicRoughness=look)
    uv = made.accessor(np.array([[0, 0], [1, 0], [0, 1]], np.float32))
    made.node(mesh=made.mesh(made.primitive(attributes={"TEXCOORD_0": uv}, material=material)))
    return made.glb()


def with_checksums(png: bytes) -> bytes:
    """The checksums of a damaged PNG made right, so that the damage reaches its decoder."""
    data, at = bytearray(png), 8
    while at + 12 <= len(data):
        end = at + 8 + int.from_bytes(data[at : at + 4], "big")
        if end + 4 > len(data):
            break
        data[end : end + 4] = zlib.crc32(data[at + 4 : end]).to_bytes(4, "big")
        at = end + 4
    return bytes(data)


def check_pictures(folder, kind, seeds):
    """Mutate a texture; the scene is there in any case, and a note says so if the texture is missing."""
    base, path, counts = encoded(kind), folder / "a.glb", {"shown": 0, "white": 0}
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for seed in seeds:
        changed = damaged(base, np.random.default_rng(seed)) or b"x"
        path.write_bytes(cut_by(with_checksums(changed) if seed % 3 and kind[:3] == "PNG" else changed))
        with limits(trace=seed % 10 == 0), warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            scene = load(path)
            _ = scene.cutouts
            textures = scene.appearance.textures
            assert all(texture.mips.dtype == np.uint8 for texture in textures)
        assert bool(textures) != any("shown in pink" in note for note in scene.notes), seed
        counts["shown" if textures else "white"] += 1
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < MEGABYTES << 10  # Pillow's own memory, kB
    return counts


@pytest.mark.parametrize("kind", PICTURES)
def test_damaged_textures(tmp_path, kind):
    counts = check_pictures(tmp_path, kind, range(30))
    assert counts["shown"] > 0 and counts["white"] > 0


@pytest.mark.slow
@pytest.mark.parametrize("kind", PICTURES)
def test_damaged_textures_at_length(tmp_path, kind):
    check_pictures(tmp_path, kind, range(1000, 4000))


def draco_change(base: bytes, rng) -> bytes:
    """A change within the Draco data of a GLB, whose length stays."""
    text, binary = split_glb(base, "a.glb")
    document = json.loads(text)
    primitive = document["meshes"][0]["primitives"][0]
    view = document["bufferViews"][primitive["extensions"]["KHR_draco_mesh_compression"]["bufferView"]]
    start, size, data = len(base) - len(binary) + view["byteOffset"], view["byteLength"], bytearray(base)
    for _ in range(rng.integers(1, 4)):
        at = start + int(rng.integers(min(size, 60) if rng.random() < 0.5 else size))
        data[at] = int(rng.choice([rng.integers(256), 0, 1, 127, 128, 255]))
    return bytes(data)


@pytest.mark.parametrize("seeds", [range(60), pytest.param(range(1000, 8000), marks=pytest.mark.slow)], ids=len)
def test_damaged_draco(tmp_path, seeds):
    pytest.importorskip("DracoPy", reason="no DracoPy: damaged Draco files are NOT tested")
    from formats.gltf.test_gltf_meshes_draco import textured

    counts = run(tmp_path / "a.glb", textured(True).glb(), seeds, draco_change)
    assert counts["error"] > 10 and counts["scene"] > 10


def several_odd_values(base: bytes, rng) -> bytes:
    """Two or three odd values at once, as a file or as a sequence of features."""
    document = json.loads(base)
    for _ in range(rng.integers(2, 4)):
        document = with_odd_value(document, rng)
    try:
        return city_files.sequence(document).encode()
    except (KeyError, TypeError, AttributeError):  # no objects are left to list
        return json.dumps(document).encode()


@pytest.mark.parametrize("seeds", [range(60), pytest.param(range(1000, 8000), marks=pytest.mark.slow)], ids=len)
def test_damaged_cities(tmp_path, seeds):
    counts = run(tmp_path / "a.city.jsonl", bases()["a.city.json"], seeds, several_odd_values)
    assert counts["error"] > 20 and counts["scene"] > 5


# --- All readers, with changes that Hypothesis shrinks ----------------------------------------------------------------


PIECES = [
    b"", b"\0", b"-1", b"0", b"9" * 20, b"1e400", b"nan", b"-2147483648", b"2147483648", b"\xff\xff\xff\xff",
    b"\x00\x00\x00\x80",
    b"<", b">", b"{", b"[", b'"', b"..", b"/", b"\n", b" ", b",", b"\xef\xbb\xbf", b"x",
]  # fmt: skip
CHANGES = st.lists(
    st.tuples(
        st.sampled_from(["replace", "insert", "cut", "repeat", "flip", "end"]),
        st.floats(0, 1, exclude_max=True),
        st.integers(0, 40),
        st.one_of(st.sampled_from(PIECES), st.binary(max_size=8)),
    ),
    min_size=1,
    max_size=4,
)
"""What to do, where (a share of the file), over how many bytes, and with which bytes."""

BUDGET = float(os.environ.get("ANTUMBRA_FUZZ_SECONDS", "300"))
"""Seconds of processor time of `test_all_readers_at_length`."""


def changed(data: bytes, changes) -> bytes:
    """The bytes after changes of `CHANGES`."""
    for kind, share, length, piece in changes:
        a = int(share * len(data))
        b = a + length
        match kind:
            case "replace":
                data = data[:a] + piece + data[a + len(piece) :]
            case "insert":
                data = data[:a] + piece + data[a:]
            case "cut":
                data = data[:a] + data[b:]
            case "repeat":
                data = data[:b] + data[a:b] * 3 + data[b:]
            case "flip":
                data = data[:a] + bytes([data[a] ^ (1 << length % 8)]) + data[a + 1 :] if data else data
            case _:
                data = data[:a]
    return data


def check_reader(folder, name, examples, number=0):
    """Damage a seed, and read it: the result is a value or an InputError of one line."""
    each = SEEDS[name]
    each.write(folder)
    target = folder / (each.damaged or each.path)
    good = target.read_bytes()
    counts = {"read": 0, "refused": 0}

    @hypothesis.seed(number)
    @settings(max_examples=examples, deadline=None, database=None, suppress_health_check=list(HealthCheck))
    @given(CHANGES)
    def read(changes):
        target.write_bytes(changed(good, changes))
        with limits(trace=False), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                each.read(folder / each.path)
                counts["read"] += 1
            except InputError as error:
                assert "\n" not in str(error) and len(str(error)) < 600
                counts["refused"] += 1

    read()
    return counts


def test_every_reader_has_a_seed():
    seeds = {(each.damaged or each.path) for each in SEEDS.values()}
    for suffix in {*SCENE_SUFFIXES, *POINT_SUFFIXES, *ENVIRONMENT_SUFFIXES, *TREE_SUFFIXES}:
        assert any(name.endswith(suffix) for name in seeds), suffix


@pytest.mark.parametrize("name", SEEDS)
def test_all_readers(tmp_path, name):
    SEEDS[name].write(tmp_path)
    SEEDS[name].read(tmp_path / SEEDS[name].path)
    assert sum(check_reader(tmp_path, name, 25).values()) >= 20


@pytest.mark.slow
def test_all_readers_at_length(tmp_path):
    """For an hour: ``ANTUMBRA_FUZZ_SECONDS=3600 pytest -n 0 -m slow FILE -k all_readers``, where FILE is this one."""
    end, number, counts = time.process_time() + BUDGET, 1, {"read": 0, "refused": 0}
    while time.process_time() < end:
        for name in SEEDS:
            folder = tmp_path / f"{number} {name}"
            folder.mkdir()
            for kind, count in check_reader(folder, name, 50, number).items():
                counts[kind] += count
            if time.process_time() > end:
                break
        number += 1
    assert counts["read"] > 0 and counts["refused"] > 0
