"""The plan `auto` on a machine with a card: lists go there once that pays, with the hits of the CPU."""

import numpy as np
import pytest

from antumbra.devices.device import DeviceError
from antumbra.engine import card_choice
from antumbra.engine.card_choice import CardChoice
from antumbra.engine.device_rays import DeviceRayLists
from antumbra.engine.engine import Engine
from truths import soup_scene

MANY = 10_000_000


@pytest.fixture
def on_host(monkeypatch):
    """A machine on which the host device passes for a card."""
    monkeypatch.delenv("ANTUMBRA_DEVICE", raising=False)
    monkeypatch.setattr(card_choice, "card", lambda: "host:0")


@pytest.fixture
def looked(monkeypatch):
    """How often drivers were asked for cards, on a machine without one."""
    calls = []
    monkeypatch.setattr(card_choice, "card", lambda: calls.append(1))
    return calls


def test_a_card_is_chosen_once_lists_would_have_gained_what_it_takes_to_open(on_host):
    choice, chosen = CardChoice(1000, 2), []
    for _ in range(9):
        chosen.append(choice.pays(MANY, True))
    assert chosen == sorted(chosen) and chosen[-1] and not chosen[0]
    assert not choice.pays(100, True)  # launches take longer
    choice.give_up()
    assert not choice.pays(MANY, True)


def test_short_lists_never_start_a_driver_and_long_ones_do_once(looked):
    choice = CardChoice(1000, 2)
    assert not any(choice.pays(100, any_hit) for any_hit in (True, False) for _ in range(1000)) and not looked
    assert not any(choice.pays(MANY, True) for _ in range(20)) and len(looked) == 1


def test_nearest_hits_pay_later_because_more_is_copied_back(on_host):
    def lists_until(any_hit):
        choice, n = CardChoice(1000, 1), 0
        while not choice.pays(MANY, any_hit):
            n += 1
        return n

    assert lists_until(False) >= lists_until(True) > 0


def rays_in(scene):
    low, high = np.asarray(scene.bounds)
    return low + np.random.default_rng(1).random((2, 300, 3)) * (high - low)


def test_lists_on_the_card_have_the_hits_of_the_cpu(on_host, monkeypatch):
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


def test_a_card_that_fails_leaves_the_list_to_the_cpu(on_host, monkeypatch):
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


def test_bandwidths_are_measured_on_the_device(on_host):
    there, back = card_choice._bandwidths("host:0")
    assert there > 0 and back > 0
    assert str(CardChoice(10, 1).plan) == "bsah+device:host:0"
