"""Checks the built site: no page scrolls sideways on a phone, no picture is missing, and the search finds its words.

    python scripts/pages.py docs/_build [--shots FOLDER]

Pages are loaded in headless Chromium, 390 pixels wide, and as wide as a desktop's. Without Chromium these checks are
skipped, with a line. --shots also keeps a picture of each page, in both widths.
"""

import argparse
import functools
import http.server
import json
import re
import shutil
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

WIDTHS = 390, 1280  # pixels
NAMES = "chromium", "chromium-browser", "google-chrome", "chrome"
WORDS = {
    "viewshed": "jobs/line-of-sight",
    "lightmap": "tutorials/bake",
    "notebook": "notebook",
    "ambient": "gallery",
    "occlusion": "gallery",
    "shadow": "tutorials/model",
    "utm": "wrong-elsewhere",
}
"""Words, and a page that a search for each must list."""

_CHECK = """<!doctype html><meta charset="utf-8"><body><script>
const pages = PAGES, widths = WIDTHS, found = [];
const wait = ms => new Promise(done => setTimeout(done, ms));
async function load(page, width) {
  const frame = document.createElement("iframe");
  frame.style = `width: ${width}px; height: 900px; border: 0`;
  frame.src = page;
  await new Promise(done => { frame.onload = done; document.body.append(frame); });
  await wait(50);
  const root = frame.contentDocument.documentElement;
  const past = [...root.querySelectorAll("article *")].filter(e => e.getBoundingClientRect().right > width + 1)
    .slice(0, 3).map(e => `${e.tagName} ${e.className} ${e.textContent.trim().slice(0, 60)}`);
  const images = [...root.querySelectorAll("article img")];
  images.forEach(image => image.loading = "eager");
  await Promise.all(images.map(image => image.decode().catch(() => 0)));
  const broken = images.filter(image => !image.naturalWidth).map(image => image.getAttribute("src"));
  found.push({page, width, wide: root.scrollWidth, past, broken});
  frame.remove();
}
(async () => {
  for (const page of pages) for (const width of widths) await load(page, width);
  const told = document.createElement("pre");
  told.id = "found";
  told.textContent = JSON.stringify(found);
  document.body.replaceChildren(told);
  document.title = "done";
})();
</script>"""


class _Server(http.server.SimpleHTTPRequestHandler):
    """Serves the site and the page that checks it, without lines on the terminal."""

    check = ""

    def do_GET(self):
        if self.path == "/_check.html":
            body = self.check.encode()
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(body)
        else:
            super().do_GET()

    def log_message(self, *_):
        pass


def pages_of(site: Path) -> list[str]:
    """The site's pages, without those that Sphinx adds."""
    found = (path.relative_to(site).as_posix() for path in sorted(site.rglob("*.html")))
    return [page for page in found if not page.startswith(("_", "genindex", "search", "py-modindex"))]


def chromium() -> str | None:
    """The browser's command, if there is one."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


def looked_at(site: Path, browser: str, shots: Path | None) -> list[dict]:
    """What the browser finds: a dict for each page and width."""
    pages = pages_of(site)
    _Server.check = _CHECK.replace("PAGES", json.dumps(pages)).replace("WIDTHS", json.dumps(WIDTHS))
    handler = functools.partial(_Server, directory=str(site))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}/"
        told = _run(browser, "--dump-dom", "--virtual-time-budget=600000", f"{address}_check.html")
        if shots is not None:
            _shoot(browser, address, pages, shots)
        server.shutdown()
    found = re.search(r'<pre id="found">(.*?)</pre>', told, re.DOTALL)
    if not found:
        sys.exit("pages.py: the browser has not finished")
    return json.loads(found[1].replace("&lt;", "<").replace("&gt;", ">").replace("&amp;", "&"))


def _run(browser: str, *options: str) -> str:
    with tempfile.TemporaryDirectory() as profile:
        always = "--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={profile}"
        done = subprocess.run([browser, *always, *options], capture_output=True, text=True, timeout=900)
        return done.stdout


def _shoot(browser: str, address: str, pages: list[str], folder: Path) -> None:
    """Pictures of the beginning of each page. Chromium's windows have a least width, so the page is in a frame."""
    folder.mkdir(parents=True, exist_ok=True)
    for page in pages:
        for width in WIDTHS:
            _Server.check = (
                f'<body style="margin:0"><iframe src="{page}" style="border:0;width:{width}px;height:1600px">'
            )
            name = f"{page.removesuffix('.html').replace('/', '-')}-{width}.png"
            size = f"--window-size={max(width, 500)},1600"
            _run(browser, size, "--virtual-time-budget=4000", f"--screenshot={folder / name}", f"{address}_check.html")


def faults(found: list[dict]) -> list[str]:
    """Lines about pages that scroll sideways, and pictures that are missing."""
    lines = [
        f"{f['page']} is {f['wide']} pixels wide at {f['width']}: {f['past']}" for f in found if f["wide"] > f["width"]
    ]
    return lines + [f"{f['page']} lacks {f['broken']}" for f in found if f["broken"] and f["width"] == WIDTHS[0]]


def unfound(site: Path) -> list[str]:
    """Lines about words that the search does not find where it should."""
    text = (site / "searchindex.js").read_text(encoding="utf-8")
    index = json.loads(text.removeprefix("Search.setIndex(").removesuffix(")"))
    lines = []
    for word, page in WORDS.items():
        listed = set()
        for terms in (index["terms"], index["titleterms"]):
            at = [terms[term] for term in terms if term.startswith(word[: max(4, len(word) - 3)])]
            listed |= {n for numbers in at for n in (numbers if isinstance(numbers, list) else [numbers])}
        if page not in {index["docnames"][n] for n in listed}:
            lines.append(f"a search for {word!r} does not find {page}")
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("site", type=Path, help="the folder of the built site")
    parser.add_argument("--shots", type=Path, metavar="FOLDER")
    options = parser.parse_args()
    lines, browser = unfound(options.site), chromium()
    if browser is None:
        print("pages.py: NO CHROMIUM, so widths and pictures are not checked", file=sys.stderr)
    else:
        lines += faults(looked_at(options.site, browser, options.shots))
    print(*lines, sep="\n", end="\n" * bool(lines))
    return bool(lines)


if __name__ == "__main__":
    sys.exit(main())
