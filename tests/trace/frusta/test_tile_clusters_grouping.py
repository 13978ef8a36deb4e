"""Tile groups are formed where they have paid."""

import numpy as np
import pytest

from antumbra.kernels.jit import kernel
from antumbra.kernels.simd import ptr
from antumbra.trace.frusta.tile_clusters import TRIAL_FLOATS, Grouping, group_pays, record_costs, reset_trials


@kernel
def _decide(memory, c, together, apart, decisions):
    """Decide about clusters of class c whose tiles cost these numbers with a group, and without."""
    trials = ptr(memory)
    reset_trials(trials)
    for i in range(len(decisions)):
        pays, trial = group_pays(trials, c)
        decisions[i] = pays
        taken = np.int64(c) if pays and trial else np.int64(-1)
        declined = np.int64(1) << c if trial and not pays else np.int64(0)
        cost = together[i] if pays else apart[i]
        record_costs(trials, Grouping(np.int64(0), taken, declined), np.int64(16) * cost, np.int64(0xFFFF))


@pytest.mark.parametrize("c", range(4))
@pytest.mark.parametrize("ratio", [0.3, 0.7, 1.5, 4.0])
def test_the_cheaper_way_is_taken(c, ratio):
    rng = np.random.default_rng(c)
    apart = (1000 * rng.lognormal(0, 0.7, 2000)).astype(np.int64)
    together = (ratio * apart).astype(np.int64)
    decisions = np.zeros(2000, bool)
    _decide(np.zeros(TRIAL_FLOATS, np.float32), c, together, apart, decisions)
    later = decisions[1000:].mean()
    assert later > 0.8 if ratio < 1 else later < 0.2
    assert 0 < later < 1, "the other way is tried again"
