"""Writes docs/papers/: a page for each paper, from the results of ``antumbra bench all --output FOLDER``.

    python scripts/paper_pages.py FOLDER

A bench whose results are not in FOLDER keeps its page.
"""

import shutil
import sys
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "docs" / "papers"
MARK = "<!-- scripts/paper_pages.py writes this page from the results of antumbra bench. Changes here are lost. -->"


class Paper(NamedTuple):
    """The part of a page that no measurement changes."""

    title: str
    cited: str  # the paper, as a sentence
    note: str  # the design note


PAPERS = {
    "multi-frusta": Paper(
        "Multi-frusta tracing",
        "[Benthin and Wald 2009] trace soft shadows by 16 frusta at once.",
        "multifrusta",
    ),
    "pre-bvh-culling": Paper(
        "Pre-BVH culling",
        "[Selgrad et al. 2015] drop the triangles that no shadow ray can meet, before they build a BVH.",
        "culling",
    ),
    "srdh": Paper(
        "SRDH",
        "[Feltman et al. 2012] build trees, and choose orders of traversal, for a sample of the shadow rays.",
        "srdh",
    ),
    "ray-hierarchy": Paper(
        "Ray hierarchies",
        "[Olsson and Assarsson 2011] build a hierarchy over the shadow rays, and none over the scene.",
        "rayhierarchy",
    ),
    "chc-rt": Paper(
        "CHC+RT",
        "[Mattausch et al. 2015] cull hidden geometry for rays of any kind, in core and out of core.",
        "chcrt",
    ),
    "peers": Paper(
        "Beside Embree",
        "This page is of no paper. It compares the default plan with Embree on the same rays.",
        "multifrusta",
    ),
}
"""Bench -> its page, in the order of the docs."""


def front(name: str) -> str:
    """The beginning of a page, which no measurement changes."""
    paper = PAPERS[name]
    told = f"[](../design/{paper.note}.md) explains the methods. `antumbra bench {name}` measures again."
    return f"{MARK}\n\n# {paper.title}\n\n{paper.cited} {told}\n\n"


def page(name: str, tables: str, pictures: list[str]) -> str:
    """A page: the front, how it was measured, the plots, and the tables.

    tables : the file NAME.md that the bench has written
    pictures : names of files beside the page
    """
    head, _, rest = tables.partition("\n\n")
    assert head == f"# antumbra bench {name}", head
    header, _, measured = rest.partition("\n\n")
    shown = "".join(f"```{{image}} {picture}\n:alt: {_alt(name, picture)}\n```\n\n" for picture in pictures)
    return f"{front(name)}## How it was measured\n\n{header}\n\n## Results\n\n{shown}{measured}"


def _alt(name: str, picture: str) -> str:
    return f"Plot of antumbra bench {name}" if picture == f"{name}.png" else picture.removesuffix(".png")


def pictures_of(name: str, folder: Path) -> list[Path]:
    """The plot of a bench, and its further pictures."""
    further = sorted(folder.glob("*-figure-*.png")) if name == "chc-rt" else []
    return [path for path in (folder / f"{name}.png", *further) if path.is_file()]


def main(folder: Path) -> None:
    PAGES.mkdir(exist_ok=True)
    for name in PAPERS:
        tables = folder / f"{name}.md"
        if not tables.is_file():
            print(f"{name}: no results in {folder}, so its page stays", file=sys.stderr)
            continue
        pictures = pictures_of(name, folder)
        for picture in pictures:
            shutil.copyfile(picture, PAGES / picture.name)
        text = page(name, tables.read_text(encoding="utf-8"), [picture.name for picture in pictures])
        (PAGES / f"{name}.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    main(Path(sys.argv[1]))
