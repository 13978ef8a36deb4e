"""Transmittance of materials and objects, from the file to pictures, visibility, sun hours and baked values."""

import numpy as np
import pytest

import antumbra as at
from antumbra.cli.scene_arguments import parse_scene
from antumbra.scene.alpha_masks import channels_of, find_cutouts
from antumbra.scene.appearance import Appearance
from antumbra.scene.materials import Material, Texture, srgb_to_linear
from baked_files import Glb
from gltf_files import Gltf

SUN = at.DirectionalLight((0, -1, 0))


def room(**material):
    """A GLB of a floor below a pane."""
    file = Gltf()
    square = np.array([[-1, 0, -1], [-1, 0, 1], [1, 0, 1], [-1, 0, -1], [1, 0, 1], [1, 0, -1]], np.float32)
    pane = file.add("materials", name="pane", **material)
    floor = file.add("materials", name="floor", pbrMetallicRoughness={"metallicFactor": 0})
    file.node(name="window", mesh=file.mesh(file.primitive(square + np.float32([0, 1, 0]), material=pane)))
    file.node(name="ground", mesh=file.mesh(file.primitive(4 * square, material=floor)))
    return file.glb()


def load(tmp_path, transmittance=None, **material):
    path = tmp_path / "room.glb"
    path.write_bytes(room(**material))
    return at.load(path, up="y", transmittance=transmittance)


def below(scene, n=1):
    """The visibility of the sun from n points below the pane, some of them below its diagonal."""
    points = np.zeros((n, 3))
    points[:, 0] = np.linspace(0, 0.5, n)
    return at.visibility(scene, points, [SUN], normals=np.tile([0, 1.0, 0], (n, 1)))


@pytest.mark.parametrize("alpha", [0.25, 0.7, 0.9985])
def test_blended_panes_let_the_rest_pass(tmp_path, alpha):
    scene = load(tmp_path, alphaMode="BLEND", pbrMetallicRoughness={"baseColorFactor": [1, 0, 0, alpha]})
    seen = below(scene, 5)
    assert seen.colour is None
    assert np.allclose(seen.fraction, 0 if alpha == 0.9985 else 1 - alpha, rtol=1e-6)
    assert (seen.bits > 0).all() == (alpha == 0.9985)
    hit = scene.occluded([[0.1, 0.5, 0.2]], [[0, 1.0, 0]])
    assert hit == (alpha >= 0.5)


def test_transmission_is_tinted_by_the_base_colour(tmp_path):
    factor = {"transmissionFactor": 0.5}
    scene = load(
        tmp_path, pbrMetallicRoughness={"baseColorFactor": [1, 0.5, 0.25, 1]},
        extensions={"KHR_materials_transmission": factor},
    )  # fmt: skip
    seen = below(scene)
    assert np.allclose(seen.colour, [0.5, 0.25, 0.125], rtol=1e-6)
    assert np.allclose(seen.fraction, np.mean([0.5, 0.25, 0.125]), rtol=1e-6)
    assert not scene.notes


@pytest.mark.parametrize("name", ["pane", "window", "p?ne", "win*"])
def test_names_choose_materials_and_objects(tmp_path, name):
    assert np.allclose(below(load(tmp_path, {name: 0.3}), 3).fraction, 0.3, rtol=1e-6)
    assert (below(load(tmp_path), 3).fraction == 0).all()


def test_a_scene_of_arrays_lets_light_pass():
    corners = np.array([[[-2, 1, -2], [2, 1, -2], [0, 1, 4]]], float)
    scene = at.Scene.from_arrays(corners, name="sail")
    scene.set_transmittance({"sail": (1, 0, 0.5)})
    assert np.allclose(at.visibility(scene, [[0, 0, 0]], [SUN]).colour, [[1, 0, 0.5]])


@pytest.mark.parametrize(
    "shares, message",
    [({"door": 0.5}, "no material or object is called 'door'.*pane"), ({"pane": 1.5}, "transmittance of 'pane'"),
     ({"pane": [1, 2]}, "red, green and blue, or one of these per month"), ("pane", "dict"),
     ({"pane": [0.5] * 11}, "per month"), ({"pane": {"jan": 0.5}}, "per month"), ({"pane": []}, "per month"),
     ({"pane": [0.5] * 11 + [-1]}, "'pane' in dec is -1; it must be a number from 0 to 1"), ({3: 0.5}, "a name"),
     ({"pane": [[1, 2]] + [0.5] * 11}, "'pane' in jan is .*red, green and blue"), ({"pane": "0.5"}, "'pane' is '0.5'")],
)  # fmt: skip
def test_wrong_transmittance_is_refused(tmp_path, shares, message):
    with pytest.raises(at.InputError, match=message):
        load(tmp_path, shares)


def test_a_pane_may_stop_some_colours_and_let_the_others_pass():
    corners = np.array([[[-2, 1, -2], [2, 1, -2], [0, 1, 4]]], float)
    scene = at.Scene.from_arrays(corners, name="red glass")
    scene.set_transmittance({"red glass": (1, 0, 0)})
    seen = at.visibility(scene, [[0, 0, 0]], [SUN])
    assert np.array_equal(seen.colour, [[[1, 0, 0]]]) and np.allclose(seen.fraction, 1 / 3)


def test_the_command_line_reads_shares():
    spec = parse_scene("a/room.glb?transmittance=pane:0.25&transmittance=roof glass:1,0.5,0&cutouts=on")
    assert spec.transmittance == (("pane", 0.25), ("roof glass", (1.0, 0.5, 0.0))) and spec.cutouts
    year = "0.7/0.7/0.6/1,0.5,0/0.3/0.2/0.2/0.2/0.3/0.5/0.6/0.7"
    ((name, months),) = parse_scene("room.glb?transmittance=oak:2:" + year).transmittance
    assert name == "oak:2" and months[:4] == (0.7, 0.7, 0.6, (1.0, 0.5, 0.0)) and len(months) == 12
    wrongs = ["0.5", "pane:a", "pane:1,2", "pane:", ":1", "pane:" + year[4:], "pane:" + year + "/1", "pane:1/2"]
    for wrong in *("transmittance=" + wrong for wrong in wrongs), "cutouts=on&glass=1":
        with pytest.raises(at.InputError, match=r"room\.glb"):
            parse_scene("room.glb?" + wrong)


def test_pictures_are_darkened_and_tinted(tmp_path):
    """Direct light on the floor below the pane is that of the open floor times the transmittance."""
    scene, clear = load(tmp_path, {"pane": (0.9, 0.6, 0.3)}), load(tmp_path, {"pane": 1.0})
    camera, dark = at.Camera((0, 3, 0.01), (0, 0, 0), width=32, height=32), at.load(tmp_path / "room.glb")
    images = {}
    for name, each in {"tinted": scene, "clear": clear, "dark": dark}.items():
        for smooth in (False, True):
            images[name, smooth] = at.render(each, camera, [SUN], spp=4, filter=smooth).image[14:18, 14:18]
    for smooth in (False, True):
        ambient = images["clear", smooth] * 0.12 / 1.12
        expected = (images["clear", smooth] - ambient) * [0.9, 0.6, 0.3] + ambient
        assert np.allclose(images["tinted", smooth], expected, rtol=0.03)


def test_every_light_is_dimmed_alike(tmp_path):
    """With a pane over the whole sky, each light loses the same share of its light."""
    lights = {
        "quad": at.QuadLight((-0.2, 3, -0.2), (0.4, 0, 0), (0, 0, 0.4)),
        "list": at.PointLights([[0.1, 3, 0], [0, 3, 0.1]], 50.0),
        "sky": at.Sky(),
    }
    clear, grey = load(tmp_path, {"pane": 1.0}), load(tmp_path, {"pane": 0.5})
    camera = at.Camera((0, 0.5, 0.01), (0, 0, 0), width=16, height=16, vfov=20)
    for name, light in lights.items():
        full, half = (at.render(s, camera, [light], spp=16, filter=False) for s in (clear, grey))
        through = half.image[8, 8] / full.image[8, 8]
        if name == "quad":  # its image has ambient light
            through = half.visibility[0][8, 8] / full.visibility[0][8, 8]
        if name == "sky":
            assert (through > 0.5).all() and (through < 1.0).all()
        else:
            assert np.allclose(through, 0.5, rtol=1e-5)


def test_hours_of_sun_count_the_share_that_arrives(tmp_path):
    place, hours = at.Place(0.0, 0.0, timezone="UTC"), {}
    for share in (0.0, 0.25, 1.0):
        scene = load(tmp_path, {"pane": share})
        table = at.sun_hours(scene, at.sensors_of("grid:0.5", scene), "2026-03-21", place=place)
        hours[share] = table["sun_hours"]
    blocked = hours[1.0] - hours[0.0]
    assert (blocked > 1).sum() > 5
    np.testing.assert_allclose(hours[0.25] - hours[0.0], 0.25 * blocked, rtol=1e-6, atol=1e-9)


def test_baked_light_is_dimmed(tmp_path):
    """The light of a lamp above a pane, at the corners of the floor."""
    values, lamp = {}, at.PointLight((0, 1.25, 0), intensity=10.0)
    for share in (0.0, (1.0, 0.5, 0.25), 1.0):
        scene = load(tmp_path, {"pane": share})
        at.bake(scene, tmp_path / "out.glb", "light", lights=[lamp], spp=1, attribute="_LIGHT", exposure=1.0)
        values[share] = Glb(tmp_path / "out.glb").attribute("_LIGHT", 2)
    whole, tinted = values[1.0], values[1.0, 0.5, 0.25]
    assert whole.min() > 0 and (values[0.0] == 0).all()
    np.testing.assert_allclose(tinted, whole * [1.0, 0.5, 0.25], rtol=1e-5)


def test_textures_of_many_colours_are_reduced():
    """The mean of each channel stays within 2 % of full light."""
    y, x = np.indices((64, 64))
    pixels = np.dstack([4 * x, 4 * y, 2 * (x + y), np.full_like(x, 255)]).astype(np.uint8)
    material = Material(texture=Texture("window", pixels), transmission=1.0)
    square = np.array([[[0, 0], [1, 0], [1, 1]]], np.float32)
    look = Appearance([material], np.zeros(1, np.int32), square, None, None, None, np.ones(1, bool))
    found = find_cutouts(look)
    assert channels_of(found.depths) == 3 and len(found.depths) == 256
    passing = np.exp2(-found.depths[found.texels, :3] / 2.0**24)
    assert np.allclose(passing.mean(0), srgb_to_linear(pixels[..., :3] / 255).mean((0, 1)), atol=0.02)
