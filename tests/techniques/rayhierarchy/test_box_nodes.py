"""Nodes of ray hierarchies: they reject no triangle that meets a ray, and "covered" means that all rays are blocked."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given, reject

import antumbra as at
from antumbra.lab.papers.ray_hierarchy.cone_hierarchy import Cones
from antumbra.techniques.culling.pre_bvh_culling import soup_of
from antumbra.techniques.rayhierarchy.box_nodes import Boxes
from antumbra.techniques.rayhierarchy.light_beams import beams_of
from beam_scenes import LIGHTS, RECEIVERS, beside_a_small_light, lit
from hierarchies import hierarchy, met_by, said
from strength import examples

SCALES = [1.0, 1e-6, 1e-3, 1e3, 1e6]
EXTREMES = [1e-36, 1e-30, 1e-20, 1e20, 1e30, 3e33]
FEW = list(LIGHTS)[:5]  # lights for which a node can be a cone around a point


def check(kind, triangles, query, ways=16, sort=True, spheres=False, apart=False):
    """Check the answers of all nodes of all hierarchies; return counts (may, may not, full, met, met by all)."""
    truth, counts = met_by(query, triangles.vertices.reshape(-1, 9)), np.zeros(5, int)
    for beam in beams_of(query, apart)[:4]:
        made = hierarchy(kind, query, beam, ways, sort or kind is Boxes)
        if made is None:
            continue
        for node, (may, full) in said(made, soup_of(triangles), spheres):
            met = truth[:, node.receivers, beam.first : beam.first + beam.n_samples]
            if beam.set >= 0:
                assert (node.receivers % 4 == beam.set).all()
            some, every = met.any((1, 2)), met.all((1, 2))
            assert not (some & ~may).any(), (
                f"{kind.__name__} loses hits: {node}, triangles {np.flatnonzero(some & ~may)}"
            )
            assert not (full & ~every).any(), (
                f"{kind.__name__} covers too much: {node}, {np.flatnonzero(full & ~every)}"
            )
            counts += may.sum(), (~may).sum(), full.sum(), some.sum(), every.sum()
    return counts


def _kinds(light):
    return [Boxes, Cones] if light in FEW else [Boxes]


@pytest.mark.parametrize("light, kind", [(light, kind) for light in LIGHTS for kind in _kinds(light)])
def test_both_answers_are_frequent_and_right(light, kind):
    counts = np.zeros(5, int)
    for seed, receivers in enumerate(list(RECEIVERS) * 4):
        counts += check(kind, *lit(seed, light, receivers, 1.0), ways=16 if seed % 3 else 4, sort=seed % 2 == 0)
    may, never, full, some, every = counts
    print(f"{light}, {kind.__name__}: may {may}, never {never}, full {full}; met {some}, by all {every}")
    assert some > 1000 and never > 0.1 * may and may < 5 * some
    assert full > 0.2 * every if light != "ambient" else full == 0


@examples(200)
@given(
    seed=st.integers(0, 2**32 - 1),
    light=st.sampled_from(list(LIGHTS)),
    receivers=st.sampled_from(list(RECEIVERS)),
    scale=st.sampled_from(SCALES * 3 + EXTREMES),
    ways=st.sampled_from([4, 16]),
    sort=st.booleans(),
    spheres=st.booleans(),
    apart=st.booleans(),
)
def test_any_rays_and_triangles(seed, light, receivers, scale, ways, sort, spheres, apart):
    try:
        triangles, query = lit(seed, light, receivers, scale)
    except at.InputError:  # this sun is too wide for so large a scene
        assert light == "sun" and scale >= 1e20
        reject()
    for kind in _kinds(light):
        check(kind, triangles, query, ways, sort, spheres and kind is Cones, apart)


@examples(100)
@given(seed=st.integers(0, 2**32 - 1), spheres=st.booleans())
def test_corners_next_to_a_small_light(seed, spheres):
    triangles, query = beside_a_small_light(seed)
    check(Boxes, triangles, query, 4)
    check(Cones, triangles, query, 4, spheres=spheres)


@pytest.mark.parametrize("m", [1, 2, 5, 17, 300])
@pytest.mark.parametrize("light", LIGHTS)
def test_any_number_of_receivers(light, m):
    triangles, query = lit(m, light, "all around", 1.0, m)
    for kind in _kinds(light):
        check(kind, triangles, query, 4)
        check(kind, triangles, query, 16)
