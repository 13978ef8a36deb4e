"""Digests of answers."""

import numpy as np

from antumbra.papers.benchmark_views import agree, digest


def test_every_bit_counts():
    bits = np.zeros((2, 3, 1), np.uint64)
    other = bits.copy()
    other[1, 2, 0] = 1 << 63
    assert digest([bits, bits]) == digest([bits, bits.copy()]) != digest([bits, other])


def test_answers_are_compared_question_by_question():
    found = [("a", b"1"), ("b", b"2"), ("a", b"1")]
    assert agree(found) and agree([])
    assert not agree([*found, ("b", b"1")])
