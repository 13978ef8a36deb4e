"""Costs: fitted rates, and what each registered tracer states."""

import numpy as np
import pytest

import antumbra as at
from antumbra.base.errors import InputError
from antumbra.engine.auto.cost_model import form_seconds, lost_share, predicted_rate, strategies
from antumbra.engine.method_registry import TRACERS
from antumbra.scene.lights import AMBIENT, FIXED
from antumbra.trace.tracer_cost import LIKELY, Cost, FittedRate, QueryFeatures, TreelessCost, terms

FEATURES = QueryFeatures(100_000, 76_800, 16, FIXED, 0.01, 0.02, 0.1)


def test_a_fitted_rate_is_the_exponential_of_its_weighted_terms():
    k = len(terms(FEATURES))
    weights = np.random.default_rng(0).normal(0, 0.1, k)
    rate = FittedRate(*weights)
    assert rate(FEATURES) == float(np.exp(terms(FEATURES) @ weights))
    assert FittedRate(np.log(7.0), *np.zeros(k - 1))(FEATURES) == pytest.approx(7.0, rel=1e-15)
    with pytest.raises(ValueError, match="mismatch"):
        FittedRate(1.0, 2.0)(FEATURES)


def test_rays_are_receivers_times_samples():
    assert FEATURES.rays == 76_800 * 16


def test_every_cost_is_plausible():
    stated = strategies()
    assert len(stated) > 4
    for name in stated:
        rates = [predicted_rate(name, FEATURES._replace(kind=kind)) for kind in (FIXED, AMBIENT)]
        assert all(1e-10 < rate < 1e-4 for rate in rates) and 0.0 <= form_seconds(name, 1000) < 1.0, name
        assert 0.0 <= lost_share(name) < 1.0


def test_only_shafts_are_risky():
    assert [name for name, tracer in strategies().items() if tracer.cost.is_risky] == ["multifrusta"]
    assert not Cost(lambda features: 1.0).is_risky and Cost(lambda features: 1.0, tried=2 * LIKELY).is_risky


def test_a_cost_per_query_counts_less_for_more_rays(monkeypatch):
    """As a device states it: a launch and a transfer for each query, and the upload of the tree."""
    launch, receiver, ray = 20_000.0, 16 / 10.0, 0.1  # nanoseconds; 16 bytes at 10 GB/s
    cost = Cost(lambda f: ray + (launch + receiver * f.receivers) / f.rays, form=20.0)
    monkeypatch.setattr(TRACERS["wide"], "cost", cost)
    few, many = (predicted_rate("wide", FEATURES._replace(receivers=n)) for n in (10, 1_000_000))
    assert few > 100 * many > 0.0


@pytest.mark.parametrize("rate", [np.nan, -1.0])
def test_a_rate_that_is_no_time_is_refused(monkeypatch, rate):
    monkeypatch.setattr(TRACERS["wide"], "cost", Cost(lambda features: rate))
    with pytest.raises(InputError, match=f"tracer 'wide' states {rate} nanoseconds per ray"):
        predicted_rate("wide", FEATURES)


@pytest.mark.parametrize("rate", [lambda features: np.inf, lambda features: 1e6 + 1e6 / features.rays])
def test_frames_without_receivers_and_tracers_that_cannot_answer(monkeypatch, rate):
    monkeypatch.setattr(TRACERS["single"], "cost", Cost(rate))
    scene, lamp = at.procedural("atrium", triangles=1000), at.PointLight((0, 7, 0))
    sky = at.Camera((0, 100, 0), (0, 200, 0), (1, 0, 0), width=48, height=40)
    empty, frame = (at.render(scene, camera, lamp, spp=4) for camera in (sky, scene.cameras[0].resized(48, 40)))
    assert empty.rays == 0 and frame.rays > 0
    assert "single" not in {choice.strategy for choice in frame.choices}


def test_a_tracer_that_states_no_cost_is_no_candidate(monkeypatch):
    assert "wide" in strategies()
    monkeypatch.setattr(TRACERS["wide"], "cost", None)
    assert "wide" not in strategies() and lost_share("wide") == lost_share(None)
    monkeypatch.setattr(TRACERS["wide"], "cost", TreelessCost(lambda features: 1.0))
    assert "wide" not in strategies() and lost_share("wide") == 0.0
