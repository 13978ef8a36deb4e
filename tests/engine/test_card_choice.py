"""The plan `auto` on a machine with a card: when lists go there."""

import pytest

from antumbra.engine import card_choice
from antumbra.engine.card_choice import CardChoice

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


def test_bandwidths_are_measured_on_the_device(on_host):
    there, back = card_choice._bandwidths("host:0")
    assert there > 0 and back > 0
    assert str(CardChoice(10, 1).plan) == "bsah+device:host:0"
