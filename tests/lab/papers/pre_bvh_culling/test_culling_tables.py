"""The tables of the benchmark of pre-BVH culling: which views lead, and which numbers are extrapolated."""

import pytest

from antumbra.lab.papers.pre_bvh_culling import culling_tables
from antumbra.lab.papers.pre_bvh_culling.culling_measurements import (
    MARKINGS,
    CullingRows,
    GridRow,
    RandomShares,
    TimeToImage,
)


def time(method, build, trace):
    return TimeToImage("another view", "single", method, 0.0, 0.0, 0.0, build, trace, 1.0, b"")


@pytest.mark.parametrize(
    "build, shown",
    [(2.0, "2"), (100.0, "100"), (101.0, "101, extrapolated"), (0.0, "1")],
)
def test_samples_beyond_the_timed_ones_are_marked_as_extrapolated(build, shown):
    bsah, lbvh = time("BSAH", build, {1: 1.0, 100: 100.0}), time("LBVH", 0.0, {1: 2.0, 100: 200.0})
    assert culling_tables._even(bsah, lbvh) == shown
    assert culling_tables._even(bsah, bsah) == ""
    assert culling_tables._even(bsah, time("LBVH", 0.0, {1: 0.5, 100: 50.0})) == "inf"


def test_random_views_lead_and_chosen_views_are_called_chosen(capsys):
    grids = [GridRow("Figure 3", 32, marked, 0.45, {}, {}, {}) for marked in MARKINGS]
    shares = [RandomShares("court", marked, [0.3, 0.4, 0.5]) for marked in MARKINGS]
    culling_tables._print_remaining(CullingRows([], [], grids, shares, []))
    lines = capsys.readouterr().out.splitlines()
    (random,) = (k for k, line in enumerate(lines) if "court, 3 random cameras" in line)
    (chosen,) = (k for k, line in enumerate(lines) if "Figure 3, chosen" in line)
    assert random < chosen and "40 (35 to 45)" in lines[random] and "45 (45)" in lines[chosen]
