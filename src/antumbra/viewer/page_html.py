"""viser's page with our title and icon, readable labels, and a panel that leaves narrow pages to the scene."""

import gzip
import re
from base64 import b64encode
from functools import lru_cache
from pathlib import Path
from typing import Any
from urllib.parse import quote

_FOLDER = Path(__file__).parent
_ICON = re.compile(rb'(<link\s+rel="icon"\s+href=")[^"]*"')

LOGO = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 64 64"><radialGradient id="a">'
    '<stop offset=".66" stop-color="#ffd778"/><stop offset=".92" stop-color="#f4a028"/>'
    '<stop offset="1" stop-color="#f4a028" stop-opacity="0"/></radialGradient>'
    '<circle cx="32" cy="32" r="32" fill="url(#a)"/><circle cx="33" cy="31" r="21" fill="#171a21"/></svg>'
)
"""An annular eclipse, as seen from the antumbra."""

ICON_ADDRESS = "data:image/svg+xml," + quote(LOGO, safe=" =:/'")
"""The logo as the address of a page's icon."""


def with_our_look(response: Any, still: bytes = b"") -> Any:
    """A response of viser's server; its page gets our look.

    still : a PNG file, which the page shows until the browser has drawn a picture
    """
    if response is not None and response.headers.get("Content-Type", "").startswith("text/html"):
        compressed = response.headers.get("Content-Encoding") == "gzip"
        response.body = _page(response.body, compressed, still)
        del response.headers["Content-Length"]  # headers may repeat, so an assignment would add another one
        response.headers["Content-Length"] = str(len(response.body))
    return response


@lru_cache(4)
def _page(body: bytes, compressed: bool, still: bytes) -> bytes:
    page = gzip.decompress(body) if compressed else body
    page = _ICON.sub(rb"\1" + ICON_ADDRESS.encode() + b'"', page, count=1)
    style, script = ((_FOLDER / name).read_bytes() for name in ("page.css", "page.mjs"))
    if still:
        style += b"html{--still:url(data:image/png;base64," + b64encode(still) + b")}"
    ours = b"<title>Antumbra</title>\n<style>" + style + b"</style>\n<script type=module>" + script + b"</script>"
    page = page.replace(b"<title>Viser</title>", ours, 1)
    page = page.replace(b'content="Viser client"', b'content="A scene with exact shadows"', 1)
    return gzip.compress(page) if compressed else page
