"""KTX2 textures, as the tools of the web encode them: colours, cut-outs, missing packages and damage."""

import json
import struct
import sys

import numpy as np
import pytest

import antumbra as at
from antumbra.scene.ktx2 import decode_ktx2, is_ktx2
from antumbra.scene.materials import PINK, decode_image
from gltf_files import Gltf, png
from repository import ROOT
from web_scene import leaf

FOLDER = ROOT / "tests" / "data" / "compressed"
LEAVES = "leaf-etc1s.ktx2", "leaf-uastc.ktx2"
LAMP = at.PointLight((12, 8, 5))
BASISU = "KHR_texture_basisu"


def data_of(name: str) -> bytes:
    return (FOLDER / name).read_bytes()


def card(image: bytes, kind="image/ktx2", fallback: bytes | None = None, **material) -> Gltf:
    """A square from (0, 0) to (24, 16) in the plane z = 0 with a texture whose texels are unit squares."""
    made = Gltf()
    source = made.add("images", bufferView=made.view(image), mimeType=kind)
    texture = {"source": source} if kind != "image/ktx2" else {"extensions": {BASISU: {"source": source}}}
    if fallback is not None:
        texture["source"] = made.add("images", bufferView=made.view(fallback), mimeType="image/png")
    sampler = made.add("samplers", magFilter=9728, minFilter=9728, wrapS=33071, wrapT=33071)
    look = {"baseColorTexture": {"index": made.add("textures", sampler=sampler, **texture)}}
    number = made.add("materials", pbrMetallicRoughness=look, doubleSided=True, **material)
    points = np.array([[0, 0, 0], [24, 0, 0], [24, 16, 0], [0, 16, 0]], np.float32)
    uv = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
    attributes = {"TEXCOORD_0": made.accessor(uv)}
    indices = np.array([0, 1, 2, 0, 2, 3], np.uint16)
    made.node(mesh=made.mesh(made.primitive(points, indices, attributes=attributes, material=number)))
    if kind == "image/ktx2":
        made.json["extensionsUsed"] = [BASISU]
        if fallback is None:
            made.json["extensionsRequired"] = [BASISU]
    return made


@pytest.mark.parametrize("name", [*LEAVES, "opaque-etc1s.ktx2"])
def test_pixels(name):
    pixels, drawn = decode_image(data_of(name)), leaf(opaque=name.startswith("opaque"))
    assert is_ktx2(data_of(name)) and not is_ktx2(png(drawn))
    assert pixels.shape == drawn.shape and pixels.dtype == np.uint8 and pixels.flags.c_contiguous
    np.testing.assert_array_equal(pixels[..., 3], drawn[..., 3])
    assert np.abs(pixels.astype(int) - drawn).max() <= 2
    assert (drawn[..., 3] == 0).any() != name.startswith("opaque")


@pytest.mark.parametrize("name", LEAVES)
def test_cutouts_let_light_through_their_holes(name, tmp_path):
    scene = at.load(card(data_of(name), alphaMode="MASK").write(tmp_path))
    y, x = np.mgrid[:16, :24] + 0.5
    origins = np.stack([x, 16.0 - y, np.ones_like(x)], axis=-1)
    occluded = scene.occluded(origins, (0.0, 0.0, -1.0))
    np.testing.assert_array_equal(occluded, leaf()[..., 3] == 255)
    assert occluded.any() and not occluded.all()
    solid = at.load(tmp_path / "made.glb", cutouts=False)
    assert solid.occluded(origins, (0.0, 0.0, -1.0)).all()


@pytest.mark.parametrize("name", LEAVES)
def test_the_scene_is_that_of_a_png_with_the_same_pixels(name, tmp_path):
    packed = at.load(card(data_of(name), alphaMode="BLEND").write(tmp_path, "a.glb"))
    plain = at.load(card(png(decode_ktx2(data_of(name))), "image/png", alphaMode="BLEND").write(tmp_path, "b.glb"))
    (first,), (second,) = (scene.appearance.textures for scene in (packed, plain))
    np.testing.assert_array_equal(first.pixels, second.pixels)
    np.testing.assert_array_equal(first.mips, second.mips)  # those stored in the file are not used
    np.testing.assert_array_equal(packed.colours, plain.colours)
    assert np.ptp(packed.colours) > 0.1


def test_files_beside_the_scene_and_fallbacks(tmp_path, monkeypatch):
    made = card(data_of(LEAVES[0]), alphaMode="MASK")
    made.json["images"][0] = {"uri": "leaf.ktx2"}
    (tmp_path / "leaf.ktx2").write_bytes(data_of(LEAVES[0]))
    beside = at.load(made.write(tmp_path, "a.gltf"))
    np.testing.assert_array_equal(beside.appearance.textures[0].pixels, decode_ktx2(data_of(LEAVES[0])))
    monkeypatch.setitem(sys.modules, "opengl_basisu", None)
    white = png(np.full((2, 2, 3), 255, np.uint8))
    assert (at.load(card(data_of(LEAVES[0]), fallback=white).write(tmp_path)).colours == 1.0).all()


def test_without_the_library_the_cure_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "opengl_basisu", None)
    path = card(data_of(LEAVES[0])).write(tmp_path)
    message = r"made.glb: images\[0\]: a KTX2 image needs opengl_basisu: pip install 'antumbra\[compressed\]'"
    for task in (lambda: at.load(path), lambda: at.bake(path, tmp_path / "out.glb", attribute="_AO", spp=4)):
        with pytest.raises(at.InputError, match=message):
            task()


def header(data: bytes, offset: int, value: int) -> bytes:
    return data[:offset] + struct.pack("<I", value) + data[offset + 4 :]


@pytest.mark.parametrize(
    "data, words",
    [
        (data_of(LEAVES[0])[:90], "cannot be used"),
        (data_of(LEAVES[1])[:-60], "cannot be used"),
        (header(data_of(LEAVES[0]), 12, 37), "cannot be used"),  # R8G8B8A8, without Basis Universal
        (header(data_of(LEAVES[0]), 20, 1 << 20), "pixels in 627 bytes are too many"),
        (header(data_of(LEAVES[0]), 36, 6), "cannot be used"),  # a cube
    ],
)
def test_damaged_images_are_pink(data, words, tmp_path):
    with pytest.warns(UserWarning, match=words):
        scene = at.load(card(data).write(tmp_path))
    np.testing.assert_allclose(scene.colours, np.broadcast_to(PINK, scene.colours.shape), atol=0.003)


def test_random_damage(tmp_path):
    rng, outcomes = np.random.default_rng(0), set()
    for name in LEAVES:
        good = data_of(name)
        for _ in range(100):
            data = bytearray(good)
            place = int(rng.integers(12, len(good)))
            data[place] = int(rng.integers(256))
            try:
                outcomes.add(decode_image(bytes(data)).shape[2])
            except ValueError:
                outcomes.add("refused")
    assert outcomes == {4, "refused"}


@pytest.mark.parametrize("options", [{"attribute": "_AO"}, {"texture": 64, "what": "light", "lights": LAMP}])
def test_a_bake_holds_png_images(options, tmp_path):
    at.bake(card(data_of(LEAVES[0]), alphaMode="MASK").write(tmp_path), tmp_path / "out.glb", spp=4, **options)
    data = (tmp_path / "out.glb").read_bytes()
    written = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
    assert {image["mimeType"] for image in written["images"]} == {"image/png"}
    assert BASISU not in json.dumps(written) and b"KTX 20" not in data
    scene = at.load(tmp_path / "out.glb")
    if "attribute" in options:
        np.testing.assert_array_equal(scene.appearance.textures[0].pixels, decode_ktx2(data_of(LEAVES[0])))
    else:  # baked light times base colours: green, as the leaf
        r, g, b = scene.appearance.textures[0].pixels[..., :3].reshape(-1, 3).max(0).tolist()
        assert g > r and g > b
