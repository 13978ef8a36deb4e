"""An independent check: Embree with its robust flag. Every difference is reported, and the oracle decides it."""

import numpy as np
import pytest

import antumbra as at
import oracle

pytest.importorskip("embreex", reason="embreex is not installed: pip install 'antumbra[peers]'")

RAYS = 200_000


@pytest.mark.parametrize("kind", ["random", "at vertices and edges"])
def test_embree_agrees_or_is_wrong(kind, capsys):
    from peers.embree import ROBUST, Device, EmbreeScene, occluded

    rng = np.random.default_rng(8)
    scene = at.procedural("atrium", triangles=20_000)
    vertices = scene.triangles().vertices
    lower, upper = vertices.min((0, 1)), vertices.max((0, 1))
    origins = rng.uniform(lower, upper, (RAYS, 3)).astype(np.float32)
    if kind == "random":
        directions = (rng.uniform(lower, upper, (RAYS, 3)) - origins).astype(np.float32)
    else:
        pick = vertices[rng.integers(0, len(vertices), RAYS)].astype(np.float64)
        along = np.where(rng.uniform(size=RAYS) < 0.5, 0.0, rng.uniform(size=RAYS))[:, None]
        directions = ((pick[:, 0] + along * (pick[:, 1] - pick[:, 0])) - origins).astype(np.float32)
    tmax = np.float32(1.0 if kind == "random" else 1.0 + 1e-5)
    ours = scene.occluded(origins + scene.origin, directions, tmax=tmax)
    origins = (origins + scene.origin - scene.origin).astype(np.float32)
    with Device(2) as device, EmbreeScene(device, vertices, flags=ROBUST) as peer:
        theirs = occluded(peer, origins, directions, tmax=tmax, threads=2)
    differ = np.nonzero(ours != theirs)[0]
    truth = oracle.occluded(vertices, origins[differ], directions[differ], tmax=tmax)
    wrong = int((theirs[differ] != truth).sum())
    with capsys.disabled():
        print(f"\n{kind}: {RAYS} rays, {len(differ)} differ from Embree (robust); Embree is wrong in {wrong} of them")
    np.testing.assert_array_equal(ours[differ], truth)
    assert len(differ) < 0.05 * RAYS and 0.2 < ours.mean() < 1.0
