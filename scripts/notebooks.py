"""Runs the notebooks of the docs, and stores or checks their output.

python scripts/notebooks.py [docs/notebooks/NAME.ipynb ...]    runs them, and compares their output; default: all
python scripts/notebooks.py --store                            stores their output instead

Texts are compared without times, and pictures by their size and by coarse tiles, since fonts differ between machines.
The first cell of each installs the package in Colab, from the repository. Requires nbclient and ipykernel.
"""

import argparse
import base64
import io
import re
import sys
import tempfile
from pathlib import Path

import nbformat
import numpy as np
from PIL import Image

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "notebooks"
_DATA = re.compile(r"(data:image/png;base64,)([\w+/=]+)")
_VARIES = re.compile(r"[\d.,]+ (?:ms|s|min)\b|\b0x[0-9a-f]+|/tmp/\S*|plan '\S+'")  # `auto` learns from times


def run(path: Path) -> nbformat.NotebookNode:
    """Run a notebook in an empty folder; return it with its output. The first cell that fails raises."""
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        resources = {"metadata": {"path": folder}}
        NotebookClient(notebook, timeout=600, kernel_name="python3", resources=resources).execute()
    return notebook


def with_output(notebook: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """A notebook that ran, with small pictures, and without progress bars, warnings and the times of its cells."""
    for cell in notebook.cells:
        cell.metadata.pop("execution", None)
        if cell.cell_type == "code":
            cell.outputs = [each for each in cell.outputs if not _is_passing(each)]
            for data in (each["data"] for each in cell.outputs if "data" in each):
                if "image/png" in data:
                    data["image/png"] = _small(data["image/png"])
                if "text/html" in data:
                    data["text/html"] = _DATA.sub(lambda match: match[1] + _small(match[2]), data["text/html"])
    return notebook


def _is_passing(output: nbformat.NotebookNode) -> bool:
    if output.output_type == "stream":
        return output.name == "stderr"
    return output.output_type == "display_data" and "image/png" not in output.data


def _small(png: str) -> str:
    """A PNG in base64 with 64 colours."""
    file = io.BytesIO()
    _picture(png).quantize(64).save(file, "PNG", optimize=True)
    return base64.b64encode(file.getvalue()).decode()


def _picture(png: str) -> Image.Image:
    return Image.open(io.BytesIO(base64.b64decode(png))).convert("RGB")


def stale(stored: nbformat.NotebookNode, ran: nbformat.NotebookNode) -> list[str]:
    """The code cells whose stored output is not that of a run."""
    cells = zip(stored.cells, ran.cells, strict=True)
    code = [(old, new) for old, new in cells if new.cell_type == "code"]
    return [f"cell {new.id}: run scripts/notebooks.py --store" for old, new in code if not _same(old, new)]


def _same(old: nbformat.NotebookNode, new: nbformat.NotebookNode) -> bool:
    (texts, pictures), (new_texts, new_pictures) = _contents(old), _contents(new)
    return texts == new_texts and len(pictures) == len(new_pictures) and all(map(_alike, pictures, new_pictures))


def _contents(cell: nbformat.NotebookNode) -> tuple[list[str], list[str]]:
    """The texts of a cell's output, without what differs from run to run, and its pictures."""
    texts, pictures = list[str](), list[str]()
    for output in cell.outputs:
        data = output.get("data", {"text/plain": output.get("text", "")})
        html = data.get("text/html", "")
        pictures += [match[2] for match in _DATA.finditer(html)] + [data[k] for k in data if k == "image/png"]
        words = _DATA.sub("", html) or data.get("text/plain", "")
        texts.append(_VARIES.sub("...", words))
    return texts, pictures


def _alike(first: str, second: str) -> bool:
    """Whether two pictures of nearly the same size have tiles of nearly the same mean colours."""
    a, b = _picture(first), _picture(second)
    tiles = [np.asarray(each.resize((8, 8), Image.Resampling.BOX), np.float64) for each in (a, b)]
    return bool(np.abs(np.subtract(a.size, b.size)).max() <= 24 and np.abs(tiles[0] - tiles[1]).max() < 24.0)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("notebooks", nargs="*", type=Path, default=sorted(FOLDER.glob("*.ipynb")))
    parser.add_argument("--store", action="store_true", help="store the output instead of comparing it")
    options = parser.parse_args()
    faults = list[str]()
    for path in options.notebooks:
        print(f"-- {path}", flush=True)
        ran = with_output(run(path))
        if options.store:
            path.write_text(nbformat.writes(ran) + "\n", encoding="utf-8")
        else:
            faults += [f"{path}: {fault}" for fault in stale(nbformat.read(path, as_version=4), ran)]
    print(*faults, sep="\n", file=sys.stderr)
    return len(faults) > 0


if __name__ == "__main__":
    sys.exit(main())
