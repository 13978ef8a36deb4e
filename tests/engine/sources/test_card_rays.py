"""Ray lists of the plan `auto` where there is a card: the CPU's hits, also if the card fails."""

import numpy as np
import pytest

from antumbra.devices.device import DeviceError
from antumbra.engine import card_choice
from antumbra.engine import engine as engine_module
from antumbra.engine.card_choice import CardChoice
from antumbra.engine.engine import Engine
from antumbra.engine.sources.device_ray_lists import DeviceRayLists
from truths import soup_scene


@pytest.fixture(autouse=True)
def on_host(monkeypatch):
    """A machine on which the host device passes for a card."""
    monkeypatch.delenv("ANTUMBRA_DEVICE", raising=False)
    monkeypatch.setattr(engine_module, "may_have_card", lambda: True)
    monkeypatch.setattr(card_choice, "card", lambda: "host:0")


def rays_in(scene):
    low, high = np.asarray(scene.bounds)
    return low + np.random.default_rng(1).random((2, 300, 3)) * (high - low)


def test_lists_on_the_card_have_the_hits_of_the_cpu(monkeypatch):
    monkeypatch.setattr(CardChoice, "pays", lambda *arguments: True)
    scene, there = soup_scene(3), []
    trace = DeviceRayLists.trace_rays
    monkeypatch.setattr(DeviceRayLists, "trace_rays", lambda *arguments: there.append(1) or trace(*arguments))
    engine, cpu, (origins, targets) = Engine(scene), Engine(scene, device="cpu"), rays_in(scene)
    blocked = engine.occluded(origins, targets=targets)
    np.testing.assert_array_equal(blocked, cpu.occluded(origins, targets=targets))
    np.testing.assert_array_equal(
        engine.closest_hit(origins, targets - origins).t, cpu.closest_hit(origins, targets - origins).t
    )
    assert len(there) == 2 and 0 < blocked.mean() < 1


def test_a_card_that_fails_leaves_the_list_to_the_cpu(monkeypatch):
    def fail(*arguments):
        raise DeviceError("no memory")

    monkeypatch.setattr(CardChoice, "pays", lambda self, *arguments: not self._never)
    monkeypatch.setattr(DeviceRayLists, "trace_rays", fail)
    scene = soup_scene(3)
    engine, (origins, targets) = Engine(scene), rays_in(scene)
    for _ in range(2):
        np.testing.assert_array_equal(
            engine.occluded(origins, targets=targets), Engine(scene, "bsah+single").occluded(origins, targets=targets)
        )
