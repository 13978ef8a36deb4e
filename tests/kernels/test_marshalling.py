"""Packed arguments of kernels select the same code as their values, and are never mistaken for them."""

from typing import NamedTuple

import numpy as np
import pytest

from antumbra.kernels.jit import kernel
from antumbra.kernels.marshalling import ArgumentForm, address_of, flatten, packed, struct_of, text_of


class Pair(NamedTuple):
    numbers: np.ndarray
    factor: float


@kernel
def _sum(numbers):
    total = 0.0
    for x in numbers:
        total += x
    return total


NUMBERS = np.arange(5.0)
VALUES = [NUMBERS, 3, 2.5, Pair(NUMBERS, 2.0), (NUMBERS, (1, 2.0), Pair(NUMBERS, 3.0))]


@pytest.mark.parametrize("value", VALUES, ids=[type(each).__name__ for each in VALUES])
def test_a_packed_value_selects_the_code_of_the_value_but_has_a_key_of_its_own(value):
    (plain, values), (grouped, words) = flatten((value,)), flatten((packed(value),))
    assert text_of(grouped) == text_of(plain) and grouped != plain
    assert struct_of(grouped).pack(*words) == struct_of(plain).pack(*values)


def test_packed_values_are_packed_again_within_others():
    inner, other = packed(NUMBERS), np.ones(2)
    both = packed((inner, other))
    key, values = flatten(((NUMBERS, other),))
    assert both.words == struct_of(key).pack(*values) and text_of(flatten((both,))[0]) == text_of(key)


def test_keys_of_equal_kinds_hold_one_string():
    assert packed(NUMBERS).group is packed(np.ones(7)).group
    assert packed(NUMBERS).group != packed(np.ones(7, np.float32)).group


def test_a_kernel_takes_an_array_and_its_packed_form_in_turn():
    for _ in range(2):
        assert _sum(NUMBERS) == 10.0 and _sum(packed(NUMBERS)) == 10.0


def test_a_form_packs_words_like_values():
    form = ArgumentForm(NUMBERS)
    by_values, by_words = form.pack(address_of(NUMBERS), 5, 8), form.of_words(packed(NUMBERS).words, NUMBERS)
    assert by_values.words == by_words.words == packed(NUMBERS).words and by_words.value is NUMBERS
    assert _sum(by_values) == _sum(by_words) == 10.0
