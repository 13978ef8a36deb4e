"""Alpha of materials: which faces and texels are solid, in files and in memory."""

import numpy as np
import pytest
import trimesh
from PIL import Image
from trimesh.visual.material import PBRMaterial

import antumbra as at
from antumbra.cli.scene_arguments import parse_scene
from antumbra.scene.alpha_masks import find_cutouts
from antumbra.scene.appearance import Appearance
from antumbra.scene.materials import BLEND, MASK, OPAQUE, Material, Texture


def card(path, alpha, mode, cutoff=0.5, factor=255):
    """A GLB of a unit square at z = 0 whose texture's alpha is `alpha`, the first row at the top."""
    pixels = np.full((*alpha.shape, 4), 255, np.uint8)
    pixels[..., 3] = alpha
    material = PBRMaterial(
        baseColorTexture=Image.fromarray(pixels),
        alphaMode=mode,
        alphaCutoff=cutoff,
        baseColorFactor=[255, 255, 255, factor],
    )
    corners, uv = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 0], [1, 0], [1, 1], [0, 1]]
    look = trimesh.visual.TextureVisuals(uv=uv, material=material)
    trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], visual=look, process=False).export(path)
    return path


def blocked(scene, n=32):
    """(n, n) bool: which rays along z hit the card; the first row is at the top."""
    at_ = (np.arange(n) + 0.5) / n
    x, y = np.meshgrid(at_, at_[::-1])
    return scene.occluded(np.stack([x, y, np.ones_like(x)], -1), [0, 0, -1.0])


CHECKERS = (np.indices((4, 8)).sum(0) % 2 * 200 + 20).astype(np.uint8)


@pytest.mark.parametrize(
    "mode, cutoff, factor, least",
    [
        ("OPAQUE", 0.5, 255, 0),
        ("MASK", 0.5, 255, 128),
        ("MASK", 0.05, 255, 13),
        ("BLEND", 0.9, 255, 128),
        ("MASK", 0.5, 140, 233),
    ],
)
def test_rays_pass_where_alpha_is_below_the_cutoff(tmp_path, mode, cutoff, factor, least):
    scene = at.load(card(tmp_path / "card.glb", CHECKERS, mode, cutoff, factor))
    expected = (least <= CHECKERS).repeat(8, 0).repeat(4, 1)
    assert np.array_equal(blocked(scene), expected)
    assert blocked(at.load(tmp_path / "card.glb", cutouts=False)).all()


def test_the_command_line_closes_holes():
    assert parse_scene("tree.glb").cutouts and parse_scene("tree.glb?cutouts=on").cutouts
    assert not parse_scene("a b/tree.GLTF?cutouts=off").cutouts
    with pytest.raises(at.InputError, match="must be on or off"):
        parse_scene("tree.glb?cutouts=maybe")


def one_face(material, alpha=None):
    colours = None if alpha is None else np.ones((1, 3, 4), np.float32) * [1, 1, 1, alpha]
    return Appearance([material], np.zeros(1, np.int32), None, colours, None, None, np.zeros(1, bool))


@pytest.mark.parametrize("mode", [OPAQUE, MASK, BLEND])
@pytest.mark.parametrize("factor, vertices, solid", [(0.6, None, True), (0.4, None, False), (1.0, 0.4, False)])
def test_alpha_without_a_texture_keeps_or_drops_whole_faces(mode, factor, vertices, solid):
    found = find_cutouts(one_face(Material(factor=(1, 1, 1, factor), alpha_mode=mode), vertices))
    if mode == BLEND:
        assert found.faces.tolist() == [0] and found.depths[0, 3] == solid
    elif mode == OPAQUE or solid:
        assert found is None
    else:
        assert not len(found.solid) and not len(found.faces)


def test_a_texture_that_cannot_be_read_is_named():
    material = Material(texture=Texture("leaf.png", b"no picture"), alpha_mode=MASK)
    appearance = one_face(material)
    appearance.textured[:] = True
    with pytest.raises(at.InputError, match=r"leaf\.png.*cutouts=False"):
        find_cutouts(appearance)
