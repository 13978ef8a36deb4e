"""The notebooks in docs/notebooks: valid, without outputs, and they run from the first cell to the last."""

import json
import os
import subprocess
import sys

import pytest

from repository import ROOT

NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


def cells_of(path):
    return [
        "".join(cell["source"])
        for cell in json.loads(path.read_text(encoding="utf-8"))["cells"]
        if cell["cell_type"] == "code"
    ]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_valid_and_has_no_outputs(path):
    nbformat = pytest.importorskip("nbformat")
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert all(not cell.outputs for cell in notebook.cells if cell.cell_type == "code")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs(path, tmp_path):
    """Its cells, as a program; what they must have computed is checked at its end."""
    for package in "xarray", "geopandas", "matplotlib", "pvlib":
        pytest.importorskip(package)
    checks = {
        "terrain": "assert scene.n_triangles > town.n_triangles and float(hours['summer'].max()) > 14\n"
        "assert 0.5 < float(lost.max()) < 14 and float(lost.min()) > -1e-6\n"
        "assert (means['winter'] < means['summer']).all() and len(means) == 2\n"
    }
    program = "\n".join([*cells_of(path), checks[path.stem]])
    ran = subprocess.run(
        [sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, env=dict(os.environ), timeout=300
    )
    assert ran.returncode == 0, ran.stderr
    assert {"sun.tif", "sun.gpkg", "sun.qml", "sun.pdf"} <= {each.name for each in tmp_path.iterdir()}


def test_there_are_notebooks():
    assert NOTEBOOKS
