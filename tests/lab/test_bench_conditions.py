"""The conditions of a measurement: kernels that have changed, and the spread of timings."""

import numpy as np
import pytest

from antumbra.bvh import binned_sah
from antumbra.kernels.jit import recorded_calls
from antumbra.lab import bench_conditions
from antumbra.lab.bench_conditions import changed_kernels, collected_laps, kernel_digests, record_laps, summary_of
from antumbra.lab.papers.bench_runner import interleave


def test_kernels_that_changed_are_named():
    with recorded_calls() as calls:
        binned_sah.build(np.random.default_rng(0).normal(size=(100, 3, 3)).astype(np.float32), 1)
    loaded = kernel_digests(calls)
    builders = [name for name in loaded if name.startswith("antumbra.bvh.")]
    assert builders and changed_kernels(loaded) == []
    name = builders[0]
    edited = {**loaded, name: dict.fromkeys(loaded[name], "0" * 32), "antumbra.bvh.no_module:_walk": {"i": "0" * 32}}
    assert changed_kernels(edited) == [name, "antumbra.bvh.no_module:_walk"]


def test_rounds_and_spreads_of_nested_timings_are_collected():
    with collected_laps() as laps:
        record_laps([1.0, 1.1, 0.9])
        record_laps([{"build": 1.0, "trace": {1: 2.0}, "rays": 5}, {"build": 2.0, "trace": {1: 2.0}, "rays": 5}])
        record_laps([(1.0, 4.0), (1.0, 6.0)])
        record_laps([3.0])  # a single round has no spread
        record_laps([bench_conditions.SHORTEST / 2, bench_conditions.SHORTEST / 4])
        interleave("a", 2, lambda case, turn: 1.0 + turn)
        record_laps([])
    assert laps.spreads == pytest.approx([0.2, 1 / 1.5, 0.0, 0.0, 0.4, 1 / 1.5])
    assert laps.rounds == [3, 2, 2, 1, 2, 2]
    record_laps([1.0, 2.0])  # nobody collects
    assert len(laps.spreads) == 6 and len(laps.rounds) == 6


def test_summary():
    assert summary_of([]) == {}
    assert summary_of([0.25]) == {"timings": 1, "median": 0.25, "ninth_decile": 0.25}
    many = summary_of([k / 10 for k in range(11)])
    assert many["timings"] == 11 and many["median"] == 0.5 and many["ninth_decile"] == pytest.approx(0.9)
