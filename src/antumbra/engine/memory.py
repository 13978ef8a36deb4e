"""The memory of a question: an estimate by what is asked, so that the chunks of a store get all the rest."""

from typing import NamedTuple

CELL_BYTES = 4
"""Of the cells of a ray set, for each receiver."""


class FrameMemory(NamedTuple):
    """Bytes of a frame."""

    fixed: int  # what the frame takes in any case
    cells: int  # cells of all shadow rays, if all are asked together
    passes: int  # all diffuse passes, if all are traced together; or the sub-pixels of all edges


def points_memory(points: int, light, samples) -> FrameMemory:
    """The memory of a query of points."""
    words = -(-samples.shape[1] // 64)
    return FrameMemory((96 + 8 * words) * points, CELL_BYTES * ray_sets(light, samples) * points, 0)


def ray_sets(light, samples) -> int:
    """How many ray sets a light has."""
    return samples.shape[1] if light.domain == "hemisphere" else 1
