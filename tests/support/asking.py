"""Helpers for tests of tracers: small queries, and the answers of the brute-force oracle to them."""

import numpy as np

import oracle
from antumbra.engine.auto_accelerator import accelerator_of
from antumbra.engine.plan import parse_plan
from antumbra.engine.primary_visibility import primary_visibility
from antumbra.query.light_samples import light_samples
from antumbra.query.shadow_query import segments, shadow_queries


def query_of(scene, camera, light, spp, time=0.0):
    """(triangles, ShadowQuery) of the surfaces that a camera sees."""
    triangles = scene.triangles(time)
    gbuffer = primary_visibility(triangles, camera, threads=2)
    return triangles, shadow_queries(triangles, gbuffer, [light], [light_samples(light, spp)])[0]


def unpack(bits, spp):
    """(h, w, spp) bool from packed bits."""
    s = np.arange(spp)
    return (bits[..., s // 64] >> (s % 64).astype(np.uint64) & np.uint64(1)).astype(bool)


def true_occlusion(triangles, query):
    """(truth, active), (h, w, spp) bool each: the correct bits of a query, by brute force; which of them are rays."""
    ends, above = segments(query)
    active = np.broadcast_to((query.sides != 0)[..., None], above.shape)
    truth = active & ~above
    y, x, s = np.nonzero(above)
    truth[y, x, s] = oracle.occluded(triangles.vertices, query.origins[y, x], ends=ends[y, x, s])
    return truth, active


def answer(plan, triangles, query, threads=2, counters=None):
    """(h, w, spp) bool: a plan's answer to a query."""
    make = accelerator_of(parse_plan(plan), threads)
    ready = make.tree_for(triangles, [query])
    return unpack(make.answer(ready, query, counters), query.samples.shape[1])
