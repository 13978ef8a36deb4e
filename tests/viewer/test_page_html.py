"""Our look of viser's page."""

import gzip
from types import SimpleNamespace

import pytest

from antumbra.viewer.page_html import ICON_ADDRESS, with_our_look
from repository import ROOT

PAGE = b"""<html><head><link
      rel="icon"
      href="data:image/svg+xml,theirs"
    /><meta name="description" content="Viser client" /><title>Viser</title></head><body>Viser</body></html>"""


def answer(body, **headers):
    return SimpleNamespace(body=body, headers={"Content-Length": str(len(body)), **headers})


@pytest.mark.parametrize("compressed", [False, True])
def test_the_page_has_our_title_icon_style_and_script(compressed):
    encoding = {"Content-Encoding": "gzip"} if compressed else {}
    got = with_our_look(
        answer(gzip.compress(PAGE) if compressed else PAGE, **{"Content-Type": "text/html"}, **encoding)
    )
    assert got.headers["Content-Length"] == str(len(got.body))
    body = (gzip.decompress(got.body) if compressed else got.body).decode()
    assert body.count("Antumbra") == 1 and "theirs" not in body and ICON_ADDRESS in body
    assert (
        body.index("<title>Antumbra")
        < body.index("<style>")
        < body.index("<script type=module>")
        < body.index("</head")
    )
    assert body.count("Viser") == 1  # of its own text


def test_other_files_remain():
    for response in answer(b"<title>Viser</title>", **{"Content-Type": "image/png"}), None:
        assert with_our_look(response) is response
        assert response is None or response.body == b"<title>Viser</title>"


def test_the_icon_is_one_address():
    assert ICON_ADDRESS.startswith("data:image/svg+xml,") and not set(ICON_ADDRESS) & set('"#<>\n')
    assert (ROOT / "docs/_static/logo.svg").is_file()


def test_the_page_shows_a_still_until_there_is_a_picture():
    headers = {"Content-Type": "text/html"}
    first, second = (with_our_look(answer(PAGE, **headers), still).body.decode() for still in (b"\x89PNG", b""))
    assert "--still:url(data:image/png;base64,iVBORw==)" in first and "data:image/png" not in second
