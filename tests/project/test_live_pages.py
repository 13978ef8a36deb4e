"""The live pages of the docs: each is made from a generated scene, and shown somewhere."""

import json
import re
from importlib.util import find_spec

import pytest

from repository import ROOT, tool

live = tool(ROOT / "scripts" / "live_pages.py")


def test_the_docs_show_all_live_pages():
    shown = [
        name for path in (ROOT / "docs").rglob("*.md") for name in re.findall(r"```\{live\} (\w+)", path.read_text())
    ]
    assert set(shown) == set(live.PAGES)


@pytest.mark.programs
@pytest.mark.skipif(find_spec("ziglang") is None, reason="without ziglang, the live pages of the docs are NOT made")
@pytest.mark.parametrize("name", live.PAGES)
def test_live_pages_are_made(tmp_path, name):
    live.write(name, tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text(encoding="utf-8")
    about = json.loads(re.search(r'id="scene">(.*?)</', text, re.S)[1])
    assert abs(about["place"]["latitude"] - live.PLACE.latitude) < 0.01 and len(text) < 1.5e6
    assert (about["layer"] is None) == (name in ("city", "village"))
