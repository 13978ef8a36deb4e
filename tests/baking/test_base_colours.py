"""The base colours of texels, and notes on what a baked texture or attribute destroys."""

import json

import numpy as np
import pytest

import antumbra as at
from baked_files import Glb, box, grid, primitive, scene_file
from gltf_files import Gltf, png

UV = np.array([[0, 0], [0, 1], [1, 0], [1, 1]], np.float32)
SUN = at.DirectionalLight((0, -1, 0), intensity=1.0)
BRICKS = np.random.default_rng(3).integers(0, 255, (64, 64, 3)).astype(np.uint8)


def floor_file(folder, repeats, pixels=BRICKS, sampler=None, parts=1):
    """Floors with a texture that repeats."""
    made = Gltf()
    image = made.add("images", bufferView=made.view(png(pixels)), mimeType="image/png")
    sampled = {} if sampler is None else {"sampler": made.add("samplers", **sampler)}
    made.add("textures", source=image, **sampled)
    look = made.add("materials", pbrMetallicRoughness={"baseColorTexture": {"index": 0}})
    for k in range(parts):
        floor = primitive(made, *grid([2 * k, 2 * k + 1], [0, 1]), TEXCOORD_0=repeats * UV, TEXCOORD_1=UV)
        made.node(mesh=made.mesh({**floor, "material": look}))
    return made.write(folder, "floor.glb")


def baked(path, folder, what="light", **options):
    return at.bake(path, folder / "out.glb", what, lights=SUN, spp=16, unlit="texture" in options, **options)


@pytest.mark.parametrize("what", ["light", "sun", "shadow"])
@pytest.mark.parametrize("uv", [None, 1], ids=["atlas", "own uv"])
def test_a_texture_that_repeats_is_noted_when_it_is_replaced(tmp_path, what, uv):
    pytest.importorskip("xatlas")
    path = floor_file(tmp_path, np.float32(16.0))
    with pytest.warns(UserWarning, match="finer than the baked one and repeat up to 16 times"):
        made = baked(path, tmp_path, what, texture=128, uv=uv)
    (note,) = made.notes
    size = int(note.rpartition(" ")[2])
    assert note.startswith("1 part has textures") and "leave unlit out" in note and 1000 < size <= 1100
    assert not baked(path, tmp_path, what, texture=size, uv=uv).notes
    assert not baked(path, tmp_path, what).notes  # COLOR_0 keeps the texture
    before, after = (Glb(file).json["images"] for file in (path, tmp_path / "out.glb"))
    assert len(before) == len(after) == 1


def test_ambient_occlusion_leaves_textures_alone(tmp_path):
    pytest.importorskip("xatlas")
    made = at.bake(floor_file(tmp_path, np.float32(16.0)), tmp_path / "out.glb", texture=64, spp=16)
    assert made.notes == () and len(Glb(tmp_path / "out.glb").json["images"]) == 2


def test_a_texture_of_the_same_resolution_is_no_loss(tmp_path):
    pytest.importorskip("scipy")
    assert not baked(floor_file(tmp_path, np.float32(1.0)), tmp_path, texture=64, uv=1).notes
    with pytest.warns(UserWarning, match="2.0 times finer") as caught:
        baked(floor_file(tmp_path, np.float32(1.0), parts=2), tmp_path, texture=32, uv=1)
    assert "repeat" not in str(caught[0].message) and str(caught[0].message).startswith("2 parts")


def test_the_command_prints_the_note(tmp_path, cli):
    pytest.importorskip("xatlas")
    path = floor_file(tmp_path, np.float32(16.0))
    told = cli("bake", path, "-o", "out.glb", "--what", "light", "--unlit", "--texture", "64", "--spp", "16")
    assert told.code == 0 and "note: 1 part has textures" in told.err
    assert (
        len(cli("bake", path, "-o", "out.glb", "--what", "sun", "--unlit", "--texture", "64", "--json").json()["notes"])
        == 1
    )


@pytest.mark.parametrize("wrap, expected", [(10497, [0, 1, 0, 1]), (33648, [0, 1, 1, 0]), (33071, [0, 1, 1, 1])])
@pytest.mark.parametrize("axis", [0, 1])
def test_textures_wrap_as_their_samplers_say(tmp_path, wrap, expected, axis):
    """A texture with a dark and a bright half, twice across a floor."""
    pytest.importorskip("scipy")
    pixels = np.zeros((16, 16, 3), np.uint8)
    pixels[:, 8:] = 255
    pixels = pixels if axis == 0 else pixels.transpose(1, 0, 2)
    repeats = np.array([2.0, 1.0] if axis == 0 else [1.0, 2.0], np.float32)
    path = floor_file(tmp_path, repeats, pixels, {"wrapS": wrap, "wrapT": wrap})
    baked(path, tmp_path, "sun", texture=64, uv=1)
    image = Glb(tmp_path / "out.glb").image()
    places = (image[32] if axis == 0 else image[:, 32])[[8, 24, 40, 56], 0]
    np.testing.assert_array_equal(places, 255 * np.array(expected))


def test_textures_that_cannot_be_read_are_noted(tmp_path):
    pytest.importorskip("scipy")
    made = Gltf()
    floor = primitive(made, *grid([0, 1], [0, 1]), TEXCOORD_1=UV)
    made.add("images", bufferView=made.view(png(BRICKS)), mimeType="image/png")
    made.add("textures", source=0)
    look = made.add("materials", pbrMetallicRoughness={"baseColorTexture": {"index": 0}})  # without TEXCOORD_0
    made.node(mesh=made.mesh({**floor, "material": look}))
    report = baked(made.write(tmp_path), tmp_path, texture=16, uv=1)
    assert report.notes == ("1 part has textures that cannot be read; they are baked as white",)


@pytest.mark.parametrize("gap, start", [(-2, "faces overlap in 1,024"), (0, "charts of"), (1, "charts of"), (3, None)])
def test_texels_of_several_charts_are_counted(tmp_path, gap, start):
    """Two squares of a part whose charts overlap, touch, or leave a gap."""
    pytest.importorskip("scipy")
    points, faces = grid([0.0, 1.0], [0.0, 1.0])
    left, right = UV * (0.5, 1.0) - (gap / 1024, 0.0), UV * (0.5, 1.0) + (0.5 + gap / 1024, 0.0)
    uv = np.clip(np.concatenate([left, right]), 0.0, 1.0).astype(np.float32)
    mesh = np.concatenate([points, points + np.float32(2.0)]), np.concatenate([faces, faces + 4])
    made = at.bake(scene_file(tmp_path, mesh, TEXCOORD_0=uv), tmp_path / "out.glb", texture=512, uv=0, spp=16)
    assert len(made.notes) == (start is not None) + (gap < 0) and all("TEXCOORD_0" in note for note in made.notes)
    assert start is None or made.notes[0].startswith(start)


def test_a_replaced_attribute_is_noted(tmp_path):
    colours = np.full((4, 3), 0.5, np.float32)
    path = scene_file(tmp_path, grid([0, 1], [0, 1]), COLOR_0=colours)
    assert at.bake(path, tmp_path / "a.glb", spp=16).notes == (
        "scene: COLOR_0 of 1 part is replaced; multiply keeps it",
    )
    assert at.bake(path, tmp_path / "a.glb", spp=16, multiply=True).notes == ()
    assert at.bake(path, tmp_path / "a.glb", spp=16, attribute="_AO").notes == ()


def test_a_scene_of_many_colours_keeps_them(tmp_path):
    """More colours than materials are worth become COLOR_0, which the baked values multiply."""
    points, faces = box((0, 0, 0), (1, 1, 1))
    corners = np.concatenate([points[faces] + np.float32(3 * k) for k in range(30)])
    colours = np.random.default_rng(1).random((len(corners), 3)).astype(np.float32)
    scene = at.Scene.from_arrays(corners, colours=colours)
    report = at.bake(scene, tmp_path / "out.glb", "shadow", lights=SUN, spp=16)
    file = Glb(tmp_path / "out.glb")
    node = next(i for i, each in enumerate(file.json["nodes"]) if "mesh" in each)
    written = file.attribute("COLOR_0", node)
    lit = written[written[:, :3].any(1)][:, :3]
    apart = np.abs(lit[:, None] - colours[None]).max(2).min(1)
    assert len(lit) > 60 and apart.max() < 1e-4 and report.notes == ()


def test_textures_of_converted_scenes_are_noted(tmp_path):
    uv, faces = UV.astype(float), grid([0, 1], [0, 1])[1]
    scene = at.Scene.from_arrays(grid([0, 1], [0, 1])[0], faces, uv=uv, texture=BRICKS)
    (note,) = at.bake(scene, tmp_path / "out.glb", spp=16).notes
    assert note.startswith("arrays: 1 texture becomes the mean colours of faces")


def test_a_clean_bake_has_no_notes(tmp_path):
    path = scene_file(tmp_path, grid([0, 1], [0, 1]))
    assert at.bake(path, tmp_path / "out.glb", spp=16).notes == ()
    assert "KHR_materials_unlit" not in json.dumps(Glb(tmp_path / "out.glb").json)
