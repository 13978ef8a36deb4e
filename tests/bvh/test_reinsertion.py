"""How long reinsertion goes on. Its trees are tested in test_optimisers.py."""

import numpy as np
import pytest

from antumbra.bvh import reinsertion
from antumbra.bvh.binned_sah import build
from antumbra.bvh.tree_quality import sah_cost, validate
from bvh_scenes import scattered


def _concentric(n):
    """Triangles with one centroid, of all sizes: bounds exclude few places."""
    rng = np.random.default_rng(36)
    corners = rng.normal(size=(n, 3, 3)) * 2.0 ** -rng.integers(0, 16, (n, 1, 1))
    corners[:, 2] = -corners[:, 0] - corners[:, 1]
    return corners.astype(np.float32)


@pytest.mark.parametrize("soup, rounds", [(_concentric, 1), (scattered, 4)])
def test_costly_rounds_are_the_last(monkeypatch, soup, rounds):
    searched, run = [], reinsertion.run

    def counted(kernel, *arguments):
        searched.append(kernel is reinsertion.find_places)
        return run(kernel, *arguments)

    monkeypatch.setattr(reinsertion, "run", counted)
    vertices = np.ascontiguousarray(soup(3000), np.float32)
    bvh = build(vertices, 1)
    better = reinsertion.reinsert(bvh, 1)
    assert sum(searched) == rounds
    validate(better, vertices)
    assert sah_cost(better) < sah_cost(bvh)
