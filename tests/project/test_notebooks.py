"""The notebooks of the docs are small, have their output, and are linked. `scripts/check examples` runs them."""

import ast
import json
import re
import subprocess
import sys
import tomllib

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
def test_a_notebook_is_short_and_shows_pictures(path):
    ran = [cell for cell in cells(path) if cell["cell_type"] == "code"]
    code = ["".join(cell["source"]) for cell in ran]
    assert 3 < len(code) < 12 and path.stat().st_size < 250_000
    assert [cell["execution_count"] for cell in ran] == list(range(1, len(ran) + 1)), "run scripts/notebooks.py --store"
    outputs = [output for cell in ran for output in cell["outputs"]]
    assert sum("image/png" in json.dumps(output) for output in outputs) >= 2
    assert not any(output["output_type"] in ("error", "stream") for output in outputs), "plots instead of lines"
    for text in code:
        ast.parse(text)
        assert max(map(len, text.splitlines())) <= 120
    assert "ANTUMBRA_SCENES" not in path.read_text(), "strangers have no such folder"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_the_colab_button_opens_this_notebook_and_installs_the_package_only_there(path):
    with (ROOT / "pyproject.toml").open("rb") as file:
        about = tomllib.load(file)["project"]
    repository = about["urls"]["Source"]
    text, install = ("".join(cell["source"]) for cell in cells(path)[:2])
    address = repository.replace("https://github.com", "https://colab.research.google.com/github")
    assert "\n[![Open in Colab](" in text and f"]({address}/blob/main/docs/notebooks/{path.name})" in text
    assert f'@ git+{repository}"' in install
    extras = re.search(r"antumbra\[([\w,]+)\]", install)[1].split(",")
    assert "jit" in extras and set(extras) <= set(about["optional-dependencies"])
    exec(install)  # outside Colab, it does nothing


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


def test_stale_output_is_named_and_times_and_fonts_are_not(tmp_path):
    nbformat = pytest.importorskip("nbformat", reason="no nbformat: the check of stored output is NOT tested")
    notebooks = tool(ROOT / "scripts" / "notebooks.py")
    stored = nbformat.read(ROOT / "docs" / "notebooks" / "terrain.ipynb", as_version=4)
    again = nbformat.read(ROOT / "docs" / "notebooks" / "terrain.ipynb", as_version=4)
    assert notebooks.stale(stored, notebooks.with_output(again)) == []
    shown = next(cell for cell in again.cells if cell.cell_type == "code" and cell.outputs)
    data = shown.outputs[0].data
    data["text/html" if "text/html" in data else "text/plain"] += " x"
    assert notebooks.stale(stored, again) == [f"cell {shown.id}: run scripts/notebooks.py --store"]
    pictures = [output.data for cell in again.cells for output in cell.get("outputs", ()) if "image/png" in output.data]
    pictures[0]["image/png"] = pictures[-1]["image/png"]
    assert len(pictures) > 1 and len(notebooks.stale(stored, again)) == 2
