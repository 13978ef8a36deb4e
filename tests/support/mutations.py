"""Files that were damaged at random."""


def mutated(data: bytes, rng) -> bytes:
    """A file with changed, missing, doubled or foreign bytes."""
    made = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        first, last = sorted(rng.integers(0, len(made), 2))
        kind = rng.integers(5)
        if kind == 0:
            made[first] = rng.integers(256)
        elif kind == 1:
            made[first] ^= 1 << int(rng.integers(8))
        elif kind == 2:
            del made[first : min(last, first + 64)]
        elif kind == 3:
            made[first:first] = made[first : min(last, first + 64)]
        else:
            made[first:last] = rng.bytes(min(int(last - first), 8))
        if not made:
            return b"x"
    return bytes(made)
