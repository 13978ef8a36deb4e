"""Runs the notebooks of the docs, and shows or hides their Colab buttons.

python scripts/notebooks.py [docs/notebooks/NAME.ipynb ...]    runs them in an empty folder; default: all
python scripts/notebooks.py --colab                            after the first release: shows the buttons, and installs

Notebooks are stored without output. Until a release is on PyPI, the button of each is an HTML comment, and the line
that installs the package in Colab is a comment too. Requires nbclient and ipykernel.
"""

import argparse
import re
import sys
import tempfile
from pathlib import Path

import nbformat

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "notebooks"
_HIDDEN_BUTTON = re.compile(r"<!-- (\[!\[Open in Colab\].*\)) -->")
_HIDDEN_INSTALL = re.compile(r"^# (%pip install )", re.MULTILINE)


def run(path: Path) -> nbformat.NotebookNode:
    """Run a notebook in an empty folder; return it with its output. The first cell that fails raises."""
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        resources = {"metadata": {"path": folder}}
        NotebookClient(notebook, timeout=600, kernel_name="python3", resources=resources).execute()
    return notebook


def with_colab(text: str) -> str:
    """The text of a cell whose button is visible and whose line that installs the package runs."""
    return _HIDDEN_INSTALL.sub(r"\1", _HIDDEN_BUTTON.sub(r"\1", text))


def show_buttons(path: Path) -> None:
    """Rewrite a notebook with its Colab button."""
    notebook = nbformat.read(path, as_version=4)
    for cell in notebook.cells:
        cell.source = with_colab(cell.source)
    path.write_text(nbformat.writes(notebook) + "\n", encoding="utf-8")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("notebooks", nargs="*", type=Path, default=sorted(FOLDER.glob("*.ipynb")))
    parser.add_argument("--colab", action="store_true", help="show the Colab buttons instead")
    options = parser.parse_args()
    for path in options.notebooks:
        print(f"-- {path}", flush=True)
        show_buttons(path) if options.colab else run(path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
