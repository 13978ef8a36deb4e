"""Tables over pages: no row is lost, each page has the headings, and columns that do not fit follow on others."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from antumbra.city.sheets.page import layout_of
from antumbra.city.sheets.page_text import text_width, wrapped
from antumbra.city.sheets.sheet_tables import SheetTable, cell_text, table_pages
from sheet_pages import boxes
from strength import examples

pytest.importorskip("matplotlib")


@examples(12)
@given(rows=st.integers(0, 300), columns=st.integers(1, 40), landscape=st.booleans())
def test_every_cell_is_on_a_page_below_its_heading(rows, columns, landscape):
    headers = [f"column {k}" for k in range(columns)]
    cells = [[f"{row}/{k}" for k in range(columns)] for row in range(rows)]
    pages = table_pages(
        layout_of("a4", landscape), [SheetTable("Results", headers, cells, frozenset(range(1, columns)))]
    )
    found = [[text.get_text() for text in page.figure.texts] for page in pages]
    assert all(each[0].startswith("Results") and "column 0" in each for each in found) and pages
    shown = [text for each in found for text in each]
    assert {cell for row in cells for cell in row} <= set(shown) and set(headers) <= set(shown)
    for page in pages:
        assert all(box[3] < page.layout.width - 9.0 and box[2] > 20.0 for box in boxes(page.figure))


def test_narrow_tables_stand_beside_each_other():
    rows = [(str(k), f"{k}.5") for k in range(360)]
    pages = table_pages(layout_of("a4", True), [SheetTable("Horizon", ("azimuth", "elevation"), rows)])
    assert len(pages) <= 3 and [text.get_text() for text in pages[0].figure.texts].count("azimuth") > 4


def test_tables_share_a_page_where_they_fit():
    small = SheetTable("One", ("a",), [("1",)])
    assert len(table_pages(layout_of("a4", False), [small, small._replace(title="Two")])) == 1


def test_cells():
    given = [
        True,
        np.bool_(False),
        np.nan,
        None,
        0.12345,
        12345.678,
        7,
        np.int64(12345),
        np.datetime64("2026-03-21T07:15"),
    ]
    assert [cell_text(each) for each in given] == [
        "yes", "no", "-", "-", "0.1235", "12,345.7", "7", "12,345", "2026-03-21 07:15",
    ]  # fmt: skip


@examples(60)
@given(text=st.text(st.sampled_from("abc W.,"), max_size=80), width=st.floats(8.0, 80.0))
def test_lines_are_as_wide_as_allowed_and_lose_nothing(text, width):
    lines = wrapped(text, 9.0, width)
    assert "".join(lines).replace(" ", "") == text.replace(" ", "")
    assert all(text_width(line, 9.0) <= width or len(line) == 1 for line in lines)
