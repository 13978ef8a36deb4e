"""Answers of several methods to the same question, compared by their digests."""

from collections.abc import Iterable
from hashlib import sha256

import numpy as np


def digest(bits: Iterable[np.ndarray]) -> bytes:
    """A digest of the bits of all lights."""
    return sha256(b"".join(b.tobytes() for b in bits)).digest()


def agree(found: Iterable[tuple[str, bytes]]) -> bool:
    """Of (question, digest) of every answer: are those to one question the same?"""
    answers: dict[str, bytes] = {}
    return all(answers.setdefault(question, bits) == bits for question, bits in found)
