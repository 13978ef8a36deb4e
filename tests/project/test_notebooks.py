"""The notebooks of the docs are small, free of output, and linked. `scripts/check examples` runs them."""

import ast
import json
import re
import subprocess
import sys

import pytest

from repository import ROOT, tool

NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


def cells(path):
    return json.loads(path.read_text(encoding="utf-8"))["cells"]


def test_there_is_one_for_each_trade_and_the_page_links_it():
    names = {path.stem for path in NOTEBOOKS}
    assert names == {"shadows", "sun_hours", "baking", "lines_of_sight", "terrain"}
    page = (ROOT / "docs" / "notebook.md").read_text()
    assert set(re.findall(r"\(notebooks/(\w+)\.ipynb\)", page)) == names


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_short_and_has_no_output(path):
    code = ["".join(cell["source"]) for cell in cells(path) if cell["cell_type"] == "code"]
    assert 3 < len(code) < 12 and path.stat().st_size < 20_000
    assert not any(cell.get("outputs") or cell.get("execution_count") for cell in cells(path))
    for text in code:
        ast.parse(text)
        assert max(map(len, text.splitlines())) <= 120
    assert "ANTUMBRA_SCENES" not in path.read_text(), "strangers have no such folder"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_colab_button_is_hidden_and_one_command_shows_it(path, tmp_path):
    pytest.importorskip("nbformat", reason="no nbformat: the Colab buttons of notebooks are NOT tested")
    notebooks = tool(ROOT / "scripts" / "notebooks.py")
    first, install = ("".join(cell["source"]) for cell in cells(path)[:2])
    assert "<!-- [![Open in Colab](" in first and f"docs/notebooks/{path.name})" in first
    assert install.startswith("# %pip install 'antumbra")
    copy = tmp_path / path.name
    copy.write_text(path.read_text())
    notebooks.show_buttons(copy)
    first, install = ("".join(cell["source"]) for cell in cells(copy)[:2])
    assert "<!--" not in first and "\n[![Open in Colab](" in first and install.startswith("%pip install")
    assert cells(copy)[2:] == cells(path)[2:]


def test_the_terrain_is_that_of_its_results(tmp_path):
    """Its cells, as a program; what they must have computed is checked at its end."""
    for package in "xarray", "geopandas", "matplotlib", "pvlib":
        pytest.importorskip(package)
    (path,) = (path for path in NOTEBOOKS if path.stem == "terrain")
    code = ["".join(cell["source"]) for cell in cells(path) if cell["cell_type"] == "code"]
    checks = (
        "assert scene.n_triangles > town.n_triangles and float(hours['summer'].max()) > 14\n"
        "assert 0.5 < float(lost.max()) < 14 and float(lost.min()) > -1e-6\n"
        "assert (means['winter'] < means['summer']).all() and len(means) == 2\n"
    )
    program = "\n".join([*code, checks])
    ran = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert ran.returncode == 0, ran.stderr
    assert {"sun.tif", "sun.gpkg", "sun.qml", "sun.pdf"} <= {each.name for each in tmp_path.iterdir()}
