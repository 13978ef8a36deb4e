"""Base colours: material factor, vertex colours, mean texture colours."""

import base64
import io

import numpy as np
import pytest
from PIL import Image

from antumbra.engine.scene_loading import load
from antumbra.scene.materials import PINK
from gltf_files import TETRAHEDRON, TETRAHEDRON_FACES, TRIANGLE, Gltf, png


def linear(srgb):
    """Linear light by IEC 61966-2-1, for a single number."""
    return srgb / 12.92 if srgb <= 0.04045 else ((srgb + 0.055) / 1.055) ** 2.4


def mean_linear(pixels):
    flat = np.asarray(pixels)[..., :3].reshape(-1, 3)
    return [np.mean([linear(v / 255) for v in channel]) for channel in flat.T.tolist()]


def textured(image, factor=(1, 1, 1, 1)) -> Gltf:
    made = Gltf()
    texture = made.add("textures", source=made.add("images", **image))
    look = {"baseColorFactor": list(factor), "baseColorTexture": {"index": texture}}
    made.node(mesh=made.mesh(made.primitive(material=made.add("materials", pbrMetallicRoughness=look))))
    return made


def in_view(data) -> Gltf:
    made = textured({})
    made.json["images"][0] = {"bufferView": made.view(data), "mimeType": "image/png"}
    return made


def colour(made, folder):
    return load(made.write(folder)).colours[0]


@pytest.mark.parametrize("shape", [(5, 7, 3), (3, 2, 4), (6, 5)])
def test_mean_texture_colour_is_taken_in_linear_light(tmp_path, shape):
    pixels = np.random.default_rng(1).integers(0, 256, shape).astype(np.uint8)
    expected = mean_linear(pixels if len(shape) == 3 else np.repeat(pixels[..., None], 3, axis=2))
    np.testing.assert_allclose(colour(in_view(png(pixels)), tmp_path), expected, rtol=1e-6)


def test_factor_times_texture_from_data_uri_and_from_beside(tmp_path):
    pixels = np.random.default_rng(2).integers(0, 256, (4, 4, 3))
    expected = np.array(mean_linear(pixels)) * (0.5, 0.25, 1.0)
    uri = "data:image/png;base64," + base64.b64encode(png(pixels)).decode()
    (tmp_path / "t.png").write_bytes(png(pixels))
    for where in (uri, "t.png"):
        made = textured({"uri": where}, (0.5, 0.25, 1.0, 0.1))
        np.testing.assert_allclose(colour(made, tmp_path), expected, rtol=1e-6)


def test_large_jpegs_are_near_their_mean(tmp_path):
    smooth = np.linspace(0, 255, 1600).astype(np.uint8)
    pixels = np.stack([np.tile(smooth, (40, 1))] * 3, axis=-1)
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "JPEG", quality=95)
    np.testing.assert_allclose(colour(in_view(stream.getvalue()), tmp_path), mean_linear(pixels), rtol=0.02)


@pytest.mark.parametrize("normalized", [True, False])
@pytest.mark.parametrize("indexed", [True, False])
def test_vertex_colours_are_averaged_over_the_face(tmp_path, indexed, normalized):
    made = Gltf()
    points, faces = (TETRAHEDRON, TETRAHEDRON_FACES) if indexed else (TRIANGLE, None)
    colours = np.random.default_rng(3).uniform(0, 1, (len(points), 4)).astype(np.float32)
    stored = np.round(colours * 65535).astype(np.uint16) if normalized else colours
    value = stored / 65535.0 if normalized else stored.astype(float)
    attributes = {"COLOR_0": made.accessor(stored, normalized=normalized)}
    material = made.add("materials", pbrMetallicRoughness={"baseColorFactor": [0.5, 1, 1, 1]})
    made.node(mesh=made.mesh(made.primitive(points, faces, attributes=attributes, material=material)))
    corners = value[faces if indexed else np.array([[0, 1, 2]])]
    expected = corners[..., :3].mean(axis=1) * (0.5, 1, 1)
    np.testing.assert_allclose(load(made.write(tmp_path)).colours, expected, rtol=1e-6)


def test_specular_glossiness_materials(tmp_path):
    made = Gltf()
    old = {"KHR_materials_pbrSpecularGlossiness": {"diffuseFactor": [0.1, 0.2, 0.3, 1]}}
    made.node(mesh=made.mesh(made.primitive(material=made.add("materials", extensions=old))))
    np.testing.assert_allclose(colour(made, tmp_path), [0.1, 0.2, 0.3], rtol=1e-6)


def test_no_material_is_white(tmp_path):
    made = Gltf()
    made.node(mesh=made.mesh())
    np.testing.assert_array_equal(colour(made, tmp_path), [1, 1, 1])


def _broken_images():
    bomb = io.BytesIO()
    Image.new("1", (6000, 6000)).save(bomb, "PNG")  # 36 million pixels in a few thousand bytes
    whole = png(np.zeros((64, 64, 3)))
    return {
        "missing": None,
        "not a picture": b"hello",
        "truncated": whole[: len(whole) // 2],
        "bomb": bomb.getvalue(),
    }


@pytest.mark.parametrize("kind", ["missing", "not a picture", "truncated", "bomb"])
def test_a_texture_that_cannot_be_used_is_pink_and_noted_once(tmp_path, kind):
    data = _broken_images()[kind]
    made = textured({"uri": "gone.png"}) if data is None else in_view(data)
    made.node(mesh=0, translation=[0, 0, 1])  # a second user of the same texture
    with pytest.warns(UserWarning, match="shown in pink") as caught:
        scene = load(made.write(tmp_path))
    assert len(caught) == 1 and len(scene.notes) == 1
    assert "made.glb: images[0]" in scene.notes[0] and "\n" not in scene.notes[0]
    np.testing.assert_allclose(scene.colours, np.tile(PINK, (2, 1)), atol=0.003)
