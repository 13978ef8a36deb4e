"""Faces that are not solid are found piece by piece as in the scene at once."""

import numpy as np

from antumbra.scene.alpha_masks import find_cutouts, masks_in
from antumbra.scene.appearance import appearance_of
from antumbra.scene.materials import BLEND, MASK, Material, Texture, look_of
from antumbra.scene.mesh import Piece
from antumbra.scene.open_faces import CLEAR, HIDDEN, FoundOpenFaces, StreamedOpenFaces
from stores import Pieces


def _pieces(rng):
    """Leaves with holes in several copies, veils with many alphas, a wall, and a mesh without a look."""
    pixels = np.full((8, 8, 4), 200, np.uint8)
    pixels[:, :6, 3] = 0
    leaf = Material("leaf", texture=Texture("leaf", pixels, has_alpha=True), alpha_mode=MASK)
    for material, copies in ((leaf, 3), (Material("veil", alpha_mode=BLEND), 1), (Material("wall"), 2), (None, 1)):
        for _ in range(3):
            size = np.repeat(rng.choice([0.05, 1.0], (200, 1)), 3, 0)
            uv, colours = 0.3 + size * rng.random((600, 2)), rng.random((600, 4))
            look = None
            if material is not None:
                look = look_of(material, uv, colours if material.name == "veil" else None)
            vertices = rng.normal(size=(copies, 600, 3)).astype(np.float32)
            yield Piece(vertices, None, np.ones(3, np.float32), "mesh", look=look)


def test_open_faces_of_pieces_are_those_of_the_scene():
    pieces = list(_pieces(np.random.default_rng(1)))
    n = sum(len(piece.vertices) * piece.vertices.shape[1] // 3 for piece in pieces)
    cutouts = find_cutouts(appearance_of(Pieces(*pieces), n))
    in_memory, streamed = FoundOpenFaces(n, cutouts, None), StreamedOpenFaces()
    for piece in pieces:
        streamed.count(piece)
    found, kinds = 0, set()
    for piece in pieces:
        right, faces = in_memory.of(piece), streamed.of(piece)
        assert np.array_equal(faces.faces, right.faces) and np.array_equal(faces.uv, right.uv)
        assert np.array_equal(faces.mask == CLEAR, right.mask == CLEAR)
        masks = streamed.masks, masks_in(cutouts)
        for number, other in set(zip(faces.mask.tolist(), right.mask.tolist())):
            kinds.add(number >= 0)
            if number >= 0:
                assert masks[0][number].shape == masks[1][other].shape
                assert np.array_equal(masks[0][number].depths, masks[1][other].depths)
        found += len(faces.faces)
    assert found > 2000 and len(kinds) == 2 and 100 < len(streamed.masks) == len(masks_in(cutouts)) <= 257


def test_parts_of_open_faces_are_numbered_from_their_first_face():
    pieces = list(_pieces(np.random.default_rng(1)))
    n = sum(len(piece.vertices) * piece.vertices.shape[1] // 3 for piece in pieces)
    hidden = np.random.default_rng(2).random(n) < 0.2
    faces = FoundOpenFaces(n, find_cutouts(appearance_of(Pieces(*pieces), n)), hidden).of(pieces[0])
    parts = [faces.part(first, first + 150) for first in range(0, 600, 150)]
    assert np.array_equal(np.concatenate([part.faces + 150 * k for k, part in enumerate(parts)]), faces.faces)
    assert np.array_equal(np.concatenate([part.mask for part in parts]), faces.mask)
    assert np.array_equal(faces.faces[faces.mask == HIDDEN], np.flatnonzero(hidden[:600]))
    assert {CLEAR, HIDDEN} < set(faces.mask.tolist())
    moved = faces.with_masks_from(7)
    assert np.array_equal(moved.mask, np.where(faces.mask >= 0, faces.mask + 7, faces.mask))
