"""Materials of a store are those of the scene, and equal images and textures are one."""

import json

import numpy as np
import pytest

from antumbra.scene.materials import MIRROR, Material, PbrParameters, Texture, TextureMap
from antumbra.store.stored_materials import (
    Images,
    StoredTextures,
    decoding_cost,
    images_of,
    material_of,
    material_to_json,
)
from gltf_files import png

PIXELS = np.random.default_rng(1).integers(0, 256, (6, 5, 4)).astype(np.uint8)


def _materials():
    encoded = png(PIXELS)
    base = Texture("base", encoded, MIRROR, nearest=True, has_alpha=True, opacity=png(PIXELS[..., :3]))
    numbers = TextureMap(Texture("numbers", PIXELS[::-1].copy(), holds_data=True), ((1.0, 0.1, 0.0), (0.0, 2.0, 0.5)))
    pbr = PbrParameters(0.3, 0.7, numbers, normal_map=TextureMap(Texture("base", encoded)), emission=(0.1, 0.0, 2.0))
    return [Material("a", (0.1, 0.2, 0.3, 0.4), base, pbr=pbr), Material("b", (np.float32(0.1), 1, 1, 1)), Material()]


def test_materials_come_back_with_the_pixels_of_their_textures():
    images = Images()
    texts = [material_to_json(each, images) for each in _materials()]
    textures = StoredTextures(images.encoded.__getitem__)
    for material, text in zip(_materials(), texts):
        found = material_of(json.loads(text), textures)
        assert found.name == material.name and found.factor == material.factor
        assert (found.pbr is None) == (material.pbr is None) and (found.texture is None) == (material.texture is None)
    found, expected = material_of(json.loads(texts[0]), textures), _materials()[0]
    without = {"metal_map": None, "normal_map": None}
    assert found.pbr._replace(**without) == expected.pbr._replace(**without)
    assert found.pbr.metal_map.transform == expected.pbr.metal_map.transform
    for name in ("wrap_s", "wrap_t", "nearest", "has_alpha", "holds_data", "pixels", "mips"):
        assert np.array_equal(getattr(found.texture, name), getattr(expected.texture, name)), name
        a, b = found.pbr.metal_map.texture, expected.pbr.metal_map.texture
        assert np.array_equal(getattr(a, name), getattr(b, name)), name


def test_images_are_kept_once_and_named_by_materials():
    images = Images()
    texts = [material_to_json(each, images) for each in _materials() * 2]
    assert texts[:3] == texts[3:] and len(images.encoded) == 3
    assert set(images_of(texts[0])) == set(images.encoded) and images_of(texts[1]) == []


def test_decoding_costs_memory_once():
    images = Images()
    text = material_to_json(_materials()[0], images)
    textures = StoredTextures(images.encoded.__getitem__)
    texture = material_of(json.loads(text), textures).texture
    assert decoding_cost([texture, texture], 4) == (6 * 60, 8 * 60)
    assert texture.mips.size and decoding_cost([texture], 4).total == 0
    assert textures.forget([]) == texture.pixels.nbytes + texture.mips.nbytes
    assert material_of(json.loads(text), textures).texture is not texture


@pytest.mark.parametrize("change", [{"wrap": [5, 0]}, {"nearest": 1}, {"name": 3}, {"wrap": [0]}])
def test_fields_that_do_not_fit_are_refused(change):
    record = json.loads(material_to_json(_materials()[0], Images()))
    record["texture"] |= change
    with pytest.raises((ValueError, TypeError)):
        material_of(record, StoredTextures(lambda key: b""))
