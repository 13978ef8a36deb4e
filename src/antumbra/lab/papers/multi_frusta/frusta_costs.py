"""Costs of multi-frusta tracing: a time per operation, fitted to measured counts, and what explains a speedup.

A tracer's time is modelled as a sum of costs per operation times counts: a fixed cost per 16 rays, a node, a triangle
accessed and culled, a triangle left after culling, a test of a triangle with 16 rays, and a test that float32 leaves
undecided. The costs of each tracer are fitted to several cases, which differ in scene and light, with relative errors
as the measure and without negative costs. `explain` then splits a speedup over packets in two: with the paper's counts
per 16 rays at our costs, and with ours at the paper's.

The paper's own costs, in cycles, are fitted to Table 1 in the same way, with the columns that it has.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import frusta_published

OPERATIONS = {
    "packets": "16 rays",
    "nodes": "node",
    "triangles": "triangle",
    "candidates": "triangle left",
    "triangle_tests": "16-ray test",
    "uncertain": "undecided",
}
"""Operation -> its name in tables; "packets" are 16 rays each."""

PUBLISHED_OPERATIONS = ("packets", "nodes", "triangles", "triangle_tests")

Counts = Mapping[str, float]


class FittedCosts(NamedTuple):
    """The costs of a tracer's operations."""

    costs: dict[str, float]  # operation -> seconds, or the paper's cycles
    errors: list[float]  # predicted time / measured time - 1, of each case

    def predict(self, counts: Counts) -> float:
        """The time of these counts."""
        return sum(cost * counts[operation] for operation, cost in self.costs.items())


def operations_of(row: Counts) -> dict[str, float]:
    """The counts of OPERATIONS from a tracer's counters; rays that need no tracing belong to no packet."""
    rays = row["rays"] - row["below_horizon"]
    return {"packets": rays / 16, **{name: row[name] for name in OPERATIONS if name != "packets"}}


def fit(counts: Sequence[Counts], times: Sequence[float], operations: Iterable[str] = OPERATIONS) -> FittedCosts:
    """Fit costs to the times of several cases, by least squares of the relative errors.

    counts : per case, the counts of all operations
    times : (n,) seconds or cycles, positive
    """
    names = list(operations)
    rows = np.array([[case[name] for name in names] for case in counts], float)
    relative = rows / np.asarray(times, float)[:, None]
    scale = np.maximum(relative.max(0), 1e-300)  # operations differ by orders of magnitude
    solved = non_negative_solution(relative / scale) / scale
    predicted = relative @ solved
    return FittedCosts(dict(zip(names, solved.tolist())), (predicted - 1.0).tolist())


def non_negative_solution(a: NDArray[np.float64]) -> NDArray[np.float64]:
    """The x >= 0 that minimises |a x - 1|^2; a: (cases, operations), few operations.

    All subsets of operations are solved, and the best solution without negative costs is returned.
    """
    ones, n = np.ones(len(a)), a.shape[1]
    best, least = np.zeros(n), float(len(a))
    for subset in range(1, 1 << n):
        columns = [k for k in range(n) if subset >> k & 1]
        x = np.linalg.lstsq(a[:, columns], ones, rcond=None)[0]
        residual = float(((a[:, columns] @ x - ones) ** 2).sum())
        if (x >= 0).all() and residual < least - 1e-12:
            best, least = np.zeros(n), residual
            best[columns] = x
    return best


def published_counts(row: frusta_published.PublishedRow) -> dict[str, float]:
    """The operations of a row of Table 1: packets of S rows are primary and shadow rays."""
    rays = frusta_published.PIXELS * (1 if row.rays == "P" else 1 + frusta_published.SPP)
    thousands = {"nodes": row.box_tests / 2, "triangles": row.triangles, "candidates": row.candidates}
    thousands["triangle_tests"] = row.triangle_tests
    return {"packets": rays / 16, **{name: 1e3 * value for name, value in thousands.items()}}


def published_costs(frusta: bool) -> FittedCosts:
    """The cycles of the paper's operations, fitted to the eight rows of Table 1 of frusta, or of packets."""
    rows = [row for row in frusta_published.TABLE1 if row.frusta == frusta]
    return fit([published_counts(row) for row in rows], [1e6 * row.cycles for row in rows], PUBLISHED_OPERATIONS)


class SpeedupExplanation(NamedTuple):
    """The speedup of frusta over packets by the models, per choice of counts and costs."""

    measured: float
    predicted: float  # our counts at our costs
    their_costs: float  # our counts at the paper's costs
    their_counts: float  # the paper's mean counts per 16 rays at our costs


def explain(
    packets: Counts, frusta: Counts, costs: tuple[FittedCosts, FittedCosts], measured: float
) -> SpeedupExplanation:
    """Split a case's speedup. packets, frusta: counts of `operations_of`; costs: ours, of packets and of frusta."""
    ours, theirs = costs, (published_costs(False), published_costs(True))
    mean = [_mean_counts(frusta=False), _mean_counts(frusta=True)]
    return SpeedupExplanation(
        measured,
        ours[0].predict(packets) / ours[1].predict(frusta),
        theirs[0].predict(packets) / theirs[1].predict(frusta),
        ours[0].predict(mean[0]) / ours[1].predict(mean[1]),
    )


def _mean_counts(frusta: bool) -> dict[str, float]:
    """The paper's mean counts per 16 rays over its scenes, with shadows; nothing is undecided there."""
    rows = [published_counts(row) for row in frusta_published.TABLE1 if row.frusta == frusta and row.rays == "S"]
    mean = {name: float(np.mean([row[name] / row["packets"] for row in rows])) for name in rows[0]}
    return {**mean, "uncertain": 0.0}
