"""Which faces are solid, cut or clear, against the texels of many points of each."""

import numpy as np
import pytest

from antumbra.scene.alpha_masks import cutouts_of, finite_uv
from antumbra.scene.materials import CLAMP, MIRROR, REPEAT
from cutout_scenes import holes

WRAPS = [(a, b) for a in (REPEAT, CLAMP, MIRROR) for b in (REPEAT, CLAMP, MIRROR)]


def wrapped(place, size, wrap):
    x = np.floor(place * size).astype(int)
    if wrap == CLAMP:
        return x.clip(0, size - 1)
    if wrap == MIRROR:
        return np.minimum(x % (2 * size), 2 * size - 1 - x % (2 * size))
    return x % size


def texels_of(uv, mask):
    """(f, m) uint8: the texels at many points of faces, corners included."""
    weights = np.concatenate([np.eye(3), np.random.default_rng(0).dirichlet(np.ones(3), 400)])
    places = np.einsum("mk,fka->fma", weights, uv.astype(np.float64))
    h, w = mask.texels.shape
    return mask.texels[wrapped(places[..., 1], h, mask.wrap[1]), wrapped(places[..., 0], w, mask.wrap[0])]


@pytest.mark.parametrize("wrap", WRAPS)
@pytest.mark.parametrize("size", [(24, 40), (1, 1), (3, 64)])
def test_faces_are_what_their_texels_are(wrap, size):
    rng = np.random.default_rng(sum(size))
    y, x = np.indices(size)
    mask = holes((x // 9 + y // 9) % 2 == 0, wrap)
    uv = (rng.uniform(-3, 3, (900, 1, 2)) + rng.uniform(-0.2, 0.2, (900, 3, 2)) * rng.random((900, 1, 1))).astype("f4")
    own = cutouts_of(uv, np.zeros(900, np.int32), [mask])
    seen = texels_of(uv, mask)
    if own is None:
        assert seen.all() and mask.texels.all()
        return
    kinds = np.full(900, "clear")
    kinds[own.solid], kinds[own.faces] = "solid", "cut"
    assert seen[kinds == "solid"].all() and not seen[kinds == "clear"].any()
    if size == (24, 40):
        assert {"clear", "solid", "cut"} == set(kinds)
        both = seen.any(1) & ~seen.all(1)
        assert (kinds[both] == "cut").all() and both.sum() > 50


def test_faces_without_a_mask_are_solid():
    uv = np.zeros((4, 3, 2), np.float32)
    clear = holes(np.zeros((2, 2), bool), (REPEAT, REPEAT))
    own = cutouts_of(uv, np.array([-1, 0, -1, 0], np.int32), [clear])
    assert own.solid.tolist() == [0, 2] and not len(own.faces)
    assert cutouts_of(uv, np.full(4, -1, np.int32), [clear]) is None


def test_wild_texture_coordinates_are_tamed():
    uv = finite_uv(np.array([np.nan, np.inf, -np.inf, 1e30, 0.5]))
    assert np.isfinite(uv).all() and abs(uv).max() == 1e6 and uv[4] == 0.5
