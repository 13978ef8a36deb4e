"""What notebooks show of a table: its picture, its first rows, and heads that sort them."""

import base64
import html
import io
import re
from dataclasses import replace

import numpy as np
import pytest

import antumbra as at
from antumbra.city.tables.table_html import MOST_ROWS

DAY = {"place": at.Place(52.0, 4.36), "step": 120.0}


@pytest.fixture(scope="module")
def table():
    scene = at.procedural("city", triangles=5_000)
    return at.sun_hours(scene, "raster:8", "2026-06-21", **DAY)


def cells(text):
    lines = re.findall(r"<tr>(.*?)</tr>", text.partition("<tbody>")[2])
    return [[html.unescape(cell) for cell in re.findall(r"<td[^>]*>(.*?)</td>", line)] for line in lines]


def test_the_first_rows_are_listed_and_the_rest_counted(table):
    text = table._repr_html_()
    heads = re.findall(r"<th .*?>([^<>]*)</th>", text)
    assert heads[:5] == ["row", "x (m)", "y (m)", "z (m)", "sun hours (h)"]
    rows = cells(text)
    assert len(rows) == MOST_ROWS < len(table) and {len(row) for row in rows} == {len(heads)}
    assert f"{len(table):,} rows, the first {MOST_ROWS} of which are listed" in text
    assert [float(row[4]) for row in rows] == pytest.approx(table["sun_hours"][:MOST_ROWS], rel=1e-3)


def test_every_head_sorts_by_its_column(table):
    scripts = {html.unescape(each) for each in re.findall(r'onclick="(.*?)"', table._repr_html_())}
    assert len(scripts) == 1 and "this.cellIndex" in scripts.pop()


def test_the_picture_shows_the_first_numbers(table):
    from PIL import Image

    text = table._repr_html_()
    (data,) = re.findall(r'<img alt="sun_hours" src="data:image/png;base64,(.*?)"', text)
    picture = np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))
    assert picture.shape[1] == 420 and len(np.unique(picture.reshape(-1, picture.shape[-1]), axis=0)) > 50


def test_a_table_without_a_scene_has_rows_and_no_picture(table):
    text = replace(table, scene=None)._repr_html_()
    assert "<img" not in text and len(cells(text)) == MOST_ROWS


def test_names_are_escaped(table):
    column = replace(table, columns={"<b>": table.columns["sun_hours"]})._repr_html_()
    assert "<b>" not in column and "&lt;b&gt;" in column
