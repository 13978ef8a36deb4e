"""The base class of tracers, and what every registered tracer does with segments that are known to be blocked."""

import numpy as np
import pytest

import antumbra as at
from antumbra.bvh import binned_sah
from antumbra.bvh.wide_bvh import widen
from antumbra.engine.auto.strategies import TreeForms
from antumbra.engine.method_registry import TRACERS, find_method, own_methods
from antumbra.query.shadow_query import new_bits, segments
from antumbra.techniques.culling.pre_bvh_culling import soup_of
from antumbra.trace.tracer import BLOCKS, BVH, TRIANGLES, WIDE, Form, Tracer, TracerState
from asking import query_of, true_occlusion, unpack

LIGHTS = at.QuadLight((-1, 7, -1), (2, 0, 0), (0, 0, 2)), at.PointLight((0, 7, 0)), at.AmbientOcclusion(2.0)
NAMES = [*own_methods("trace"), "multifrusta:paper", "single:random", "cones:spheres"]


@pytest.fixture(scope="module", params=LIGHTS, ids=lambda light: type(light).__name__)
def asked(request):
    """(triangles, query, truth, rays): the last two (h, w, spp) bool."""
    scene = at.procedural("atrium", triangles=3000)
    triangles, query = query_of(scene, scene.cameras[0].resized(40, 32), request.param, 4)
    return triangles, query, *true_occlusion(triangles, query)


@pytest.mark.parametrize("name", NAMES)
def test_segments_known_to_be_blocked_leave_the_others_as_they_are(asked, name):
    """All tracers accept them, whether or not they save the work."""
    triangles, query, truth, rays = asked
    tracer = find_method("trace", name)[1]
    known = ~segments(query)[1] & rays  # what receivers' own surfaces block, as a caller must say
    known |= truth & (np.random.default_rng(0).random(truth.shape) < 0.5)
    bits = new_bits(query)
    bits[..., 0] = (known * (1 << np.arange(4))).sum(-1).astype(np.uint64)
    geometry = soup_of(triangles, None) if tracer.form is TRIANGLES else binned_sah.build(triangles.vertices, 2)
    tracer.trace(tracer.prepare(geometry, 2), query, bits, 2, fresh=False)
    others = rays & ~known
    np.testing.assert_array_equal(unpack(bits, 4)[others], truth[others])
    assert truth[others].any() and not truth[others].all() and (truth & known).any()


def test_a_form_is_made_once_for_all_tracers_that_have_it(asked):
    calls = []
    form = Form("mine", lambda bvh, threads: calls.append(threads) or (bvh,))
    bvh = binned_sah.build(asked[0].vertices, 2)
    forms = TreeForms(bvh, 2)
    assert forms.of(BVH) is bvh and not forms.missing(BVH) and forms.missing(form)
    assert forms.of(form) is forms.of(form) == (bvh,) and calls == [2] and not forms.missing(form)


def test_forms_of_the_built_in_tracers():
    assert {name: TRACERS[name].form for name in ("multifrusta", "packet16:blocks", "packet16", "wide", "cones")} == {
        "multifrusta": BLOCKS,
        "packet16:blocks": BLOCKS,
        "packet16": BVH,
        "wide": WIDE,
        "cones": TRIANGLES,
    }
    assert WIDE.make is widen and [name for name in own_methods("trace") if not TRACERS[name].builds] == ["cones"]


class Recorded(Tracer):
    """A tracer that records its calls."""

    description = "records its calls"

    def __init__(self):
        self.calls = []

    def trace(self, prepared, query, bits, threads=None, counters=None, progress=None, fresh=True):
        self.calls.append((prepared, query, bits, threads, fresh))


def test_defaults_of_a_tracer():
    tracer = Recorded()
    assert (tracer.builds, tracer.chooses, tracer.exact, tracer.counts_apart) == (True, False, True, False)
    assert tracer.paper == "" and tracer.cost is None and tracer.suits(None, None)
    assert tracer.prepare("a tree", 3) == "a tree"
    tracer.trace_all("a tree", ["one", "two"], ["its bits", "others"], 3, fresh=False)
    assert tracer.calls == [("a tree", "one", "its bits", 3, False), ("a tree", "two", "others", 3, False)]


def test_what_a_subclass_must_define():
    with pytest.raises(NotImplementedError):
        Tracer().trace(None, None, None)
    with pytest.raises(NotImplementedError):
        TracerState().begin()
