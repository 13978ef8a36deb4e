"""The paper's results are consistent with each other, except where `CONTRADICTIONS` says so."""

import numpy as np
import pytest

from antumbra.lab.papers.pre_bvh_culling.culling_published import (
    CONTRADICTIONS,
    DETAILS,
    GRIDS,
    TIME_TO_IMAGE,
    published_break_even,
    published_total,
)

NOTES = dict(CONTRADICTIONS)
ROWS = [(figure, method, row) for figure, methods in TIME_TO_IMAGE.items() for method, row in methods.items()]


@pytest.mark.parametrize("figure, method, row", ROWS)
def test_totals_are_the_sums_of_table_3(figure, method, row):
    """The paper multiplied the time of one sample."""
    sums = [published_total(figure, method, spp) for spp in (1, 10, 100)]
    np.testing.assert_allclose(sums, row[3:], atol=1.5e-3)
    assert "not measured" in NOTES["totals of Table 3"]


def test_sums_of_culling():
    parts = {figure: round(sum(row[2:6]), 3) for figure, row in DETAILS.items()}
    assert parts == {"Figure 3": 1.378, "Figure 4": 1.670, "Figure 5": 1.259, "Figure 6": 2.350}
    printed = {figure: row[6] for figure, row in DETAILS.items()}
    table_3 = {figure: methods["LBVH culled"][0] for figure, methods in TIME_TO_IMAGE.items()}
    assert {figure for figure in printed if printed[figure] != table_3[figure]} == {"Figure 5"}
    assert f"{printed['Figure 5']}" in NOTES["culling in Figure 5"] and "1.228" in NOTES["culling in Figure 5"]
    told = " ".join(NOTES.values())
    assert all(f"{value:.3f}" in told for value in (*parts.values(), *printed.values()))


def test_sums_of_table_4_leave_out_the_scan():
    for _, *steps, total in (row[:5] for row in GRIDS.values()):
        assert sum(steps) == pytest.approx(total, abs=1e-3)


def test_where_bsah_breaks_even():
    assert published_break_even("Figure 3", "LBVH") == pytest.approx((278.5 - 3.52) / (26.836 - 14.279))
    for figure, method, row in ROWS:
        spp = published_break_even(figure, method)
        if method != "BSAH":
            assert published_total(figure, method, spp) == pytest.approx(published_total(figure, "BSAH", spp))
            assert (spp < 100) == (row[5] > TIME_TO_IMAGE[figure]["BSAH"][5])
    below = [row for figure, _, row in ROWS if row[5] < TIME_TO_IMAGE[figure]["BSAH"][5]]
    assert len(below) == 7 and "7 of the 16" in NOTES["caption of Table 3"]
    assert published_break_even("Figure 3", "BSAH") == np.inf
