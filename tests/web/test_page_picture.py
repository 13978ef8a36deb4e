"""Pictures of pages, drawn in node, beside those of `antumbra render`: the same bits, lights, textures and bytes."""

import io
import json
import shutil
import subprocess
from datetime import datetime
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import antumbra as at
from antumbra.base.errors import InputError
from antumbra.scene.materials import CLAMP, MIRROR, REPEAT, Texture, mip_levels
from antumbra.sun.location import Place
from antumbra.web import page_look
from antumbra.web.page_columns import Columns
from antumbra.web.page_export import PageOptions, write_page
from antumbra.web.page_source import PAGE

NODE = shutil.which("node")
pytestmark = pytest.mark.skipif(
    NODE is None or find_spec("ziglang") is None, reason="without node and ziglang, pictures of pages are NOT checked"
)
SIZE = W, H = 100, 76  # the last tiles and bands are cut
SUN = at.DirectionalLight((0.3, -1.0, -0.5), 3.0, intensity=2.0, colour=(1.0, 0.9, 0.7))
LIGHTS = {
    "a sun and the sky": [SUN, at.Sky(up="y")],
    "a point": [at.PointLight((2.0, 5.0, 1.0), intensity=30.0)],
    "a quad": [at.QuadLight((1.0, 5.0, 0.0), (2.0, 0.0, 0.0), (0.0, 0.0, 2.0), intensity=30.0, colour=(1.0, 0.5, 0.2))],
    "a disk": [at.DiskLight((-3.0, 3.0, 1.0), (1.0, -1.0, 0.0), 1.0, intensity=30.0)],
    "a sphere": [at.SphereLight((3.0, 4.0, 3.0), 1.0, intensity=30.0)],
    "two suns": [SUN, at.DirectionalLight((-1.0, -1.0, 0.0), 0.0, intensity=1.0)],
    "lamps in a list": [at.PointLights(np.array([[x, 4.0, z] for x in (-4, 0, 4) for z in (-4, 4)], float))],
    "a list over the pixels": [
        at.PointLights(np.random.default_rng(5).uniform(-5, 5, (40, 3)) + (0, 8, 0), 3.0, interleave=True)
    ],
}


def hall(**look):
    """A floor with a wall and a box, of which some triangles have no area."""
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 0], [1, 1], [0, 1]], float)
    floor = np.stack([12 * square[:, 0] - 6, 0 * square[:, 0], 6 - 12 * square[:, 1]], 1)
    wall = np.stack([12 * square[:, 0] - 6, 6 * square[:, 1], 0 * square[:, 0] - 5], 1)
    box = np.stack([2 * square[:, 0] - 1, 2 * square[:, 1], 0 * square[:, 0] + 1], 1)
    lid = np.stack([2 * square[:, 0] - 1, 0 * square[:, 0] + 2, 1 - 2 * square[:, 1]], 1)
    flat = np.repeat(floor[:3], 1, 0) * (1, 0, 0)  # without area
    corners = np.concatenate([floor, flat, wall, box, lid])
    uv = 3 * np.concatenate([square, square[:3], square, square, square]) - 0.7
    more = {"uv": uv} if "texture" in look else {}
    return at.Scene.from_arrays(corners.reshape(-1, 3, 3), **more, **look)


CAMERA = at.Camera((4.0, 4.0, 9.0), (0.0, 1.0, 0.0), width=W, height=H, vfov=50.0)


@pytest.fixture
def drawn(tmp_path, monkeypatch):
    """drawn(scene, lights, ...): the linear picture of a page in node, its bytes on the screen, and what it reports."""

    def draw(scene, lights, passes=1, textures=(), camera=CAMERA, **request):
        monkeypatch.setattr(page_look, "picture_lights", lambda *_: lights)
        write_page(scene, tmp_path / "page.html", PageOptions("Hall", datetime(2026, 6, 21)), camera)
        sun = next((-s.direction for s in lights if isinstance(s, at.DirectionalLight)), None)
        for k, pixels in enumerate(textures):
            (tmp_path / f"image{k}").write_bytes(pixels.tobytes())
        images = [pixels.shape[1::-1] for pixels in textures]
        request |= {"width": W, "height": H, "passes": passes, "images": images, "rows": 32}
        request["sun"] = None if sun is None else sun.tolist()
        (tmp_path / "request.json").write_text(json.dumps(request))
        subprocess.run([NODE, Path(__file__).parent / "page_picture.mjs", PAGE, tmp_path], check=True)
        picture = np.fromfile(tmp_path / "picture.bin", np.float32).reshape(H, W, 4)
        screen = np.fromfile(tmp_path / "screen.bin", np.uint8).reshape(H, W, 4)
        return picture, screen, json.loads((tmp_path / "answers.json").read_text())

    return draw


def view_of(scene):
    """The rays and the ambient light of our picture, for the same bits."""
    rays = CAMERA.rays(scene.triangles().origin)
    return {"origin": rays.origin.tolist(), **{name: getattr(rays, name).tolist() for name in ("corner", "dx", "dy")}}


def background(frame):
    return frame.gbuffer.face < 0


@pytest.mark.parametrize("lights", LIGHTS.values(), ids=LIGHTS)
def test_the_first_pass_has_the_bits_of_our_picture(drawn, lights):
    scene = hall(colours=np.random.default_rng(2).uniform(0.2, 0.9, (9, 3)))
    frame = at.render(scene, CAMERA, lights, antialias=False)
    ambient = frame.ambient.astype(float).tolist()
    picture, _, about = drawn(scene, lights, view=view_of(scene), ambient=ambient)
    assert picture[..., :3].tobytes() == frame.image.tobytes()
    assert (picture[..., 3] == ~background(frame)).all()
    np.testing.assert_allclose(about["ambient"], ambient, rtol=1e-6)
    assert 0 < background(frame).sum() < W * H and frame.image[~background(frame)].std() > 0.01


def texture_of(pixels, s=REPEAT, t=REPEAT, nearest=False):
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG")
    return Texture("tiles.png", file.getvalue(), s, t, nearest)


@pytest.mark.parametrize(
    "wraps", [(REPEAT, CLAMP), (MIRROR, REPEAT), (CLAMP, MIRROR)], ids=["repeat", "mirror", "clamp"]
)
@pytest.mark.parametrize("nearest", [False, True], ids=["linear", "nearest"])
def test_textures_have_the_bits_of_our_picture(drawn, wraps, nearest):
    pixels = np.random.default_rng(7).integers(0, 256, (37, 50, 3)).astype(np.uint8)
    scene = hall(texture=pixels)
    (material,) = scene.appearance.materials
    texture = texture_of(pixels, *wraps, nearest)
    scene.appearance.materials[0] = material._replace(texture=texture)
    lights = LIGHTS["a sun and the sky"]
    frame = at.render(scene, CAMERA, lights, antialias=False)
    request = {"view": view_of(scene), "ambient": frame.ambient.astype(float).tolist()}
    picture, _, _ = drawn(scene, lights, textures=[texture.pixels], **request)
    assert picture[..., :3].tobytes() == frame.image.tobytes()
    plain = at.render(scene, CAMERA, lights, antialias=False, textures=False)
    assert (plain.image != frame.image).mean() > 0.3


def test_vertex_colours_and_smooth_normals_are_shown(drawn):
    scene = hall()
    generator = np.random.default_rng(3)
    n = 3 * scene.n_triangles
    corners = scene.triangles().vertices.reshape(-1, 3, 3)
    normals = np.repeat(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), 3, 0)
    normals = normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
    normals += generator.uniform(-0.2, 0.2, (n, 3))
    scene = at.Scene.from_arrays(corners, vertex_colours=generator.uniform(0.2, 0.9, (n, 3)), normals=normals)
    lights = LIGHTS["a sun and the sky"]
    frame = at.render(scene, CAMERA, lights, antialias=False)
    request = {"view": view_of(scene), "ambient": frame.ambient.astype(float).tolist()}
    picture, _, _ = drawn(scene, lights, **request)
    difference = np.abs(picture[..., :3] - frame.image)  # normals are rounded to 1 / 32767, and bends to 1 / 255
    assert np.quantile(difference, 0.99) < 1e-3 and difference.max() < 0.02
    flat = at.render(scene, CAMERA, lights, antialias=False, smooth_normals=False)
    assert np.abs(flat.image - frame.image).max() > 0.05


@pytest.mark.parametrize("name", ["a sun and the sky", "a quad"])
def test_the_screen_shows_the_bytes_of_our_file(drawn, tmp_path, name):
    scene, lights = hall(colours=np.random.default_rng(2).uniform(0.2, 0.9, (9, 3))), LIGHTS[name]
    _, screen, _ = drawn(scene, lights)
    frame = at.render(scene, CAMERA, lights, antialias=False)
    frame.save(tmp_path / "ours.png")
    ours = np.asarray(Image.open(tmp_path / "ours.png").convert("RGB")).astype(int)
    apart, free = np.abs(ours - screen[..., :3]), background(frame)
    assert apart[~free].max() <= 1  # the camera and the exposure differ in the last bits
    assert free.any() and apart[free].max() <= 1


@pytest.mark.parametrize("name", ["a sun and the sky", "a sphere"])
def test_all_passes_approach_the_picture_with_more_rays(drawn, name):
    scene, lights = hall(), LIGHTS[name]
    frames = [at.render(scene, CAMERA, lights, spp=64, adaptive=256, seed=seed) for seed in range(12)]
    ours = np.mean([frame.image for frame in frames], 0)
    tiles = lambda image: image[: H // 4 * 4].reshape(H // 4, 4, W // 4, 4, 3).mean((1, 3))
    apart = [np.abs(tiles(drawn(scene, lights, passes)[0][..., :3]) - tiles(ours)).mean() for passes in (1, 4)]
    assert apart[1] < 0.8 * apart[0] and apart[1] < 0.01 * ours.mean()


def test_mip_levels_have_the_bytes_of_our_textures(tmp_path):
    for k, (h, w) in enumerate([(1, 1), (1, 7), (37, 50), (64, 32)]):
        pixels = np.random.default_rng(k).integers(0, 256, (h, w, 4)).astype(np.uint8)
        (tmp_path / "in").write_bytes(pixels.tobytes())
        call = f"""const {{ mipLevels }} = await import("{(PAGE / "textures.mjs").as_uri()}");
            const {{ readFileSync, writeFileSync }} = await import("node:fs");
            writeFileSync("out", mipLevels(new Uint8Array(readFileSync("in")), {w}, {h}));"""
        subprocess.run([NODE, "--input-type=module", "-e", call], check=True, cwd=tmp_path)
        assert (tmp_path / "out").read_bytes() == Texture("t", pixels).mips.tobytes()
        assert len(mip_levels(pixels)) == max(h, w).bit_length() - 1


def test_a_closed_room_has_its_lamp_and_with_a_place_the_sun(monkeypatch):
    room = hall()
    lamp, sky = at.SphereLight((0.0, 2.0, 0.0), 0.3), at.Sky(up="y")
    monkeypatch.setattr(type(room), "default_lights", lambda *_: [lamp, sky])
    lights = page_look.picture_lights(room, 0.0, None)
    assert lights == [lamp, sky]
    look = {"lamps": page_look.add_lights(Columns(), lights, np.zeros(3), None)}
    assert page_look.sun_angles(look, "y") is None and [each["daylight"] for each in look["lamps"]] == [False, False]
    dated = page_look.picture_lights(room, 0.0, Place(52.0, 4.4))
    assert [type(light).__name__ for light in dated] == ["DirectionalLight", "Sky"]


@pytest.mark.parametrize("up", ["y", "z"])
def test_the_page_opens_with_the_sun_of_our_picture(up):
    scene = at.Scene.from_arrays(np.eye(3)[None], up=up)
    lights = page_look.picture_lights(scene, 0.0, None)
    records = page_look.add_lights(Columns(), lights, np.zeros(3), None)
    angles = page_look.sun_angles({"lamps": records}, up)
    azimuth, altitude = np.radians(angles["azimuth"]), np.radians(angles["altitude"])
    east, north, height = np.sin(azimuth) * np.cos(altitude), np.cos(azimuth) * np.cos(altitude), np.sin(altitude)
    towards = (east, north, height) if up == "z" else (east, height, -north)
    np.testing.assert_allclose(towards, -lights[0].direction, atol=1e-4)


def test_lights_that_pages_lack_are_refused():
    with pytest.raises(InputError, match="pages do not show AmbientOcclusion"):
        page_look.add_lights(Columns(), [at.AmbientOcclusion()], np.zeros(3), None)


def test_images_keep_their_bytes_unless_they_are_large_or_transparent():
    pixels = np.random.default_rng(1).integers(0, 256, (8, 8, 3)).astype(np.uint8)
    small = texture_of(pixels)
    assert page_look._image(small) == ("image/png", small.picture, False)
    clear = texture_of(np.dstack([pixels, np.full((8, 8), 3, np.uint8)]))
    kind, data, reduced = page_look._image(clear)
    assert (kind, reduced) == ("image/png", False)
    assert (np.asarray(Image.open(io.BytesIO(data))) == pixels).all()
    kind, data, reduced = page_look._image(texture_of(np.zeros((8, 2 * page_look.LARGEST, 3), np.uint8)))
    assert reduced and max(Image.open(io.BytesIO(data)).size) == page_look.LARGEST
