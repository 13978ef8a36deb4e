"""Counts the words of the hand-written pages: the README and docs/, without design notes, papers and generated pages.

    python scripts/document_words.py

Words are those of prose, tables and captions, and the titles of links, without blocks of code, comments, addresses of
links and texts for pictures.
"""

import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
APART = "design", "papers", "_build"
"""Folders of docs/ that are not counted."""
GENERATED = ("figures.md",)
MOST = 26_000


def pages() -> list[Path]:
    """The pages that are counted."""
    found = [path for path in DOCS.rglob("*.md") if path.relative_to(DOCS).parts[0] not in APART]
    return [ROOT / "README.md", *sorted(path for path in found if path.name not in GENERATED)]


def words(text: str) -> int:
    """The number of words of a page."""
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r"^```.*?^```$", "", text, flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"^:(?:::.*|[\w-]+:.*)$", "", text, flags=re.MULTILINE)  # fences and options of cards
    text = re.sub(r"!\[[^]]*\]", "", text)
    text = re.sub(r"\]\([^)\s]*\)", "]", text)
    return len(re.findall(r"\S*\w\S*", text))


if __name__ == "__main__":
    counts = {page: words(page.read_text(encoding="utf-8")) for page in pages()}
    for page, count in counts.items():
        print(f"{count:6,}  {page.relative_to(ROOT)}")
    print(f"{sum(counts.values()):6,}  of at most {MOST:,}")
