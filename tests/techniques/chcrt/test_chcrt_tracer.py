"""The tracer `chcrt` keeps a state per tree, and is exact only if it neglects no rays."""

from antumbra.bvh import binned_sah
from antumbra.engine.method_registry import TRACERS
from antumbra.techniques.chcrt.chc_rt import ChcRtState
from antumbra.techniques.chcrt.chcrt_tracer import ChcRtTracer
from antumbra.techniques.tracer_options import ChcRtOptions
from antumbra.trace.tracer import TracerState
from bvh_scenes import scattered


def test_only_a_threshold_of_zero_is_exact():
    assert TRACERS["chcrt"].exact and not ChcRtTracer(ChcRtOptions(threshold=20), "").exact


def test_each_tree_has_a_state_of_its_own():
    tracer, bvh = TRACERS["chcrt"], binned_sah.build(scattered(100), 1)
    one, other = tracer.prepare(bvh, 1), tracer.prepare(bvh, 1)
    assert isinstance(one, ChcRtState) and isinstance(one, TracerState) and one is not other
    assert one.options == tracer.options and TRACERS["chcrt"].form != ChcRtTracer(ChcRtOptions(), "").form
