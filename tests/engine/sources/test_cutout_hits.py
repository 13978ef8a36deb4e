"""Hits on cut-outs are those on all faces by the oracle, without holes."""

import numpy as np
import pytest

import antumbra as at
import oracle
from antumbra.engine.sources.cutout_hits import CutoutHits, of_valid
from antumbra.query.ray_list import rays_of
from antumbra.scene.triangles import HitFilter
from antumbra.trace.alpha_cutouts import cutout_tree
from antumbra.trace.rays.all_hits import INSIDE, TRIANGLES
from cutout_scenes import is_hole, rays, scene_with_cutouts


def _arguments(scene, origins, directions):
    return rays_of(origins, directions, HitFilter(), tuple(scene.origin.tolist()), scene.n_triangles)


def test_all_hits_on_cutouts_are_without_holes():
    scene = scene_with_cutouts(90)
    triangles, cutouts = scene.triangles(), scene.cutouts
    hits = CutoutHits(cutout_tree(triangles), 2)
    origins, directions = (np.asarray(each, np.float32) for each in rays(900))
    found = hits.all_hits(_arguments(scene, origins, directions), TRIANGLES, 2)
    local = (origins - scene.origin).astype(np.float32)
    right = []
    for i in range(len(origins)):
        for face in cutouts.faces.tolist():
            there, t = oracle.meets_exactly(local[i], directions[i], triangles.vertices[face])[:2]
            if there and t > 0 and not is_hole(cutouts, face, triangles.vertices[face], local[i], directions[i]):
                right.append((i, face))
    assert sorted(zip(found.ray.tolist(), found.face.tolist())) == sorted(right) and len(right) > 20
    arguments = _arguments(scene, origins, directions)
    assert np.array_equal(hits.count_hits(arguments, TRIANGLES, 2), found.counts)
    assert hits.count_hits(arguments, INSIDE, 2).sum() != found.counts.sum()  # sees no holes


def test_an_invalid_ray_is_named():
    scene = scene_with_cutouts(90)
    arguments = _arguments(scene, np.zeros((2, 3)), np.array([[0.0, 1.0, 0.0], [0.0, np.nan, 0.0]]))
    assert of_valid(arguments, 7) == 7
    with pytest.raises(at.InputError, match="directions"):
        of_valid(arguments, None)
