"""Lightmaps: textures of light beside materials that stay as they are."""

import io

import numpy as np
import pytest
from PIL import Image

import antumbra as at
from antumbra.baking.baked_textures import encode_pixels
from baked_files import Glb, box, grid, primitive
from gltf_files import Gltf, png

pytest.importorskip("scipy")
SUN = at.DirectionalLight((-0.5, -1.0, -0.25), intensity=3.0)
BRICKS = np.random.default_rng(3).integers(0, 255, (64, 64, 3)).astype(np.uint8)
UV = np.array([[0, 0], [0, 1], [1, 0], [1, 1]], np.float32)


def brick_file(folder, turn=None):
    """A floor with bricks that repeat 16 times, and a sheet above it; turn: (3, 3)."""
    turn = np.eye(3) if turn is None else turn
    made = Gltf()
    made.add("images", bufferView=made.view(png(BRICKS)), mimeType="image/png")
    made.add("textures", source=0)
    model = {"baseColorTexture": {"index": 0}, "metallicFactor": 0.0}
    look = made.add("materials", name="bricks", pbrMetallicRoughness=model)
    turned = lambda mesh: (np.ascontiguousarray(mesh[0] @ turn.T.astype(np.float32)), mesh[1])
    floor = primitive(made, *turned(grid([0, 4], [0, 4])), TEXCOORD_0=16 * UV, TEXCOORD_1=UV)
    made.node(mesh=made.mesh({**floor, "material": look}))
    sheet = primitive(made, *turned(grid([1, 2], [1, 2], 1.0)), TEXCOORD_0=UV, TEXCOORD_1=UV)
    made.node(mesh=made.mesh({**sheet, "material": look}))
    return made.write(folder, "bricks.glb")


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("what", ["light", "sun", "shadow"])
def test_a_lightmap_leaves_tiled_textures_as_they_are(tmp_path, what, bits):
    pytest.importorskip("xatlas")
    path, out = brick_file(tmp_path), tmp_path / "out.glb"
    made = at.bake(path, out, what, lights=SUN, texture=64, bit_depth=bits, spp=4, png=True)
    before, after = Glb(path), Glb(out)
    material = after.json["materials"][0]
    lightmap = material.pop("extensions").pop("MOZ_lightmap")
    assert material == before.json["materials"][0] and after.json["extensionsUsed"] == ["MOZ_lightmap"]
    assert lightmap["texCoord"] == 2 and lightmap["intensity"] == pytest.approx(
        (1.0 if what == "light" else np.pi) / made.exposure
    )
    np.testing.assert_array_equal(after.image(0), before.image(0))
    for node in (0, 1):
        uv = after.attribute("TEXCOORD_2", node)
        assert uv.min() >= 0.0 and uv.max() <= 1.0 and len(uv) == len(after.attribute("TEXCOORD_0", node))
    assert made.images == [tmp_path / "out.png"] and made.notes == ()
    view = after.json["bufferViews"][after.json["images"][1]["bufferView"]]
    stored = after.binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
    assert (
        stored[24] == bits and made.images[0].read_bytes() == stored and Image.open(io.BytesIO(stored)).size == (64, 64)
    )
    assert (at.load(out).colours == at.load(path).colours).all()  # Antumbra reads its own file


def test_the_texels_of_a_lightmap_are_the_light(tmp_path):
    """The floor in the sun has 3 lux times the cosine; below the sheet it is dark."""
    out = tmp_path / "out.glb"
    at.bake(brick_file(tmp_path), out, "light", lights=SUN, texture=64, uv=1, exposure=0.25, spp=4)
    glb = Glb(out)
    lightmap = glb.json["materials"][0]["extensions"]["MOZ_lightmap"]
    assert lightmap["texCoord"] == 1 and lightmap["intensity"] == 4.0
    uv = glb.attribute("TEXCOORD_1")
    image = glb.image(glb.json["textures"][lightmap["index"]]["source"]).astype(float)
    image = image / 255.0 * lightmap["intensity"]
    lux = 3.0 / np.sqrt(1.0 + 0.25 + 0.0625)
    assert uv.shape == (4, 2) and np.median(image[40:, 40:]) == pytest.approx(lux, rel=1e-2)


@pytest.mark.parametrize("what", ["light", "sun"])
def test_a_quarter_turn_of_scene_and_sun_changes_no_texel(tmp_path, what):
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    images = []
    for name, matrix in (("plain", np.eye(3)), ("turned", turn)):
        (tmp_path / name).mkdir()
        sun = at.DirectionalLight(matrix @ SUN.direction, intensity=3.0)
        path = brick_file(tmp_path / name, matrix)
        at.bake(path, tmp_path / name / "out.glb", what, lights=sun, texture=64, uv=1, exposure=0.25, spp=1)
        images.append(Glb(tmp_path / name / "out.glb").image(1).astype(int))
    assert np.ptp(images[0]) > 50 and np.abs(images[0] - images[1]).max() <= 1  # a step of 8 bits


def test_texels_beyond_the_range_of_the_image_are_counted(tmp_path):
    pytest.importorskip("xatlas")
    with pytest.warns(UserWarning, match=r"of [\d,]+ texels are brighter than the image holds; lower exposure"):
        at.bake(brick_file(tmp_path), tmp_path / "a.glb", "light", lights=SUN, texture=64, exposure=2.0, spp=4)


def test_occlusion_goes_into_the_slot_of_gltf(tmp_path):
    pytest.importorskip("xatlas")
    at.bake(brick_file(tmp_path), tmp_path / "out.glb", texture=64, spp=4)
    material = Glb(tmp_path / "out.glb").json["materials"][0]
    assert material["occlusionTexture"]["texCoord"] == 2 and "extensions" not in material
    assert material["pbrMetallicRoughness"]["baseColorTexture"] == {"index": 0}


def test_dithering_keeps_the_mean_between_two_levels():
    value = np.full((8, 8, 1), 10.25 / 255.0)
    assert set(encode_pixels(value, 8, False).ravel()) == {10}
    dithered = encode_pixels(value, 8, False, dither=True)
    assert set(dithered.ravel()) == {10, 11} and dithered.mean() == 10.25
    ends = np.array([[[0.0], [1.0], [1.5], [-1.0]]])
    assert encode_pixels(ends, 8, False, dither=True).ravel().tolist() == [0, 255, 255, 0]


def test_a_closed_room_is_dark_to_its_very_edges(tmp_path):
    """Texels on the edges of walls: their rays used to start on the next wall, and passed it."""
    pytest.importorskip("xatlas")
    openexr = pytest.importorskip("OpenEXR")
    points, faces = box((0, 0, 0), (4, 2.5, 3))
    made = Gltf()
    corners = points[faces[:, ::-1]].reshape(-1, 3)
    made.node(mesh=made.mesh(primitive(made, corners, np.arange(36, dtype=np.uint32))))
    report = at.bake(made.write(tmp_path), tmp_path / "out.glb", texture=64, spp=16, exr=True, keep_hidden=True)
    with openexr.File(str(report.images[0])) as file:
        assert file.channels()["Y"].pixels.max() == 0.0
