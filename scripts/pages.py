"""Checks the built site: pages do not scroll sideways on a phone, no image is missing, no file comes from another host,
the search works, and search engines find each page with a title and a description of its own.

    python scripts/pages.py docs/_build [--shots FOLDER]

Pages are loaded in headless Chromium at phone and desktop widths. Without Chromium, these checks are skipped with a
message. --shots also saves a screenshot of each page at both widths.
"""

import argparse
import functools
import html
import http.server
import json
import queue
import re
import shutil
import subprocess
import sys
import tempfile
import threading
from contextlib import contextmanager
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "docs" / "_ext"))
import search_words

WIDTHS = 390, 1280  # pixels
LONGEST = 900  # seconds for all pages
NAMES = "chromium", "chromium-browser", "google-chrome", "chrome"
WORDS = {
    "viewshed": "jobs/line-of-sight",
    "lightmap": "jobs/bake",
    "skyline": "jobs/skyline",
    "horizon": "jobs/skyline",
    "daylight": "jobs/sun",
    "notebook": "notebook",
    "ambient": "gallery",
    "occlusion": "gallery",
    "shadow": "tutorials/model",
    "utm": "wrong-elsewhere",
    "gpu": "install",
    "pvlib": "jobs/skyline",
    "trimesh": "tutorials/others",
    "error": "errors",
    "format": "files",
}
"""Search terms, and a page that each must list."""
DESCRIPTION = 50, 160  # characters, as search engines show them
MARKUP = re.compile(r"[`{}<>*]|\]\(|,,|::|^\W")

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
  await fetch("/_found", {method: "POST", body: JSON.stringify(found)});
})();
</script>"""


class _Server(http.server.SimpleHTTPRequestHandler):
    """Serves the site and the checking page, which posts its results; logs nothing."""

    check = ""
    results: queue.SimpleQueue = queue.SimpleQueue()

    def do_GET(self):
        if self.path == "/_check.html":
            body = self.check.encode()
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(body)
        else:
            super().do_GET()

    def do_POST(self):
        self.results.put(json.loads(self.rfile.read(int(self.headers["Content-Length"]))))
        self.send_response(204)
        self.end_headers()

    def log_message(self, *_):
        pass


def pages_of(site: Path) -> list[str]:
    """The site's pages, without those added by Sphinx."""
    paths = (path.relative_to(site).as_posix() for path in sorted(site.rglob("*.html")))
    return [page for page in paths if not page.startswith(("_", "genindex", "search", "py-modindex"))]


def chromium() -> str | None:
    """The browser's command, if there is one."""
    return next((path for name in NAMES if (path := shutil.which(name))), None)


def check_pages(site: Path, browser: str, shots: Path | None) -> list[dict]:
    """The results of the checks in the browser: a dict per page and width."""
    pages = pages_of(site)
    _Server.check = _CHECK.replace("PAGES", json.dumps(pages)).replace("WIDTHS", json.dumps(WIDTHS))
    handler = functools.partial(_Server, directory=str(site))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}/"
        with _opened(browser, f"{address}_check.html") as window:
            results = _wait_for_results(window)
        if shots is not None:
            _shoot(browser, address, pages, shots)
        server.shutdown()
    return results


def _wait_for_results(window: subprocess.Popen) -> list[dict]:
    """The results that the page posts."""
    for _ in range(LONGEST):
        try:
            return _Server.results.get(timeout=1)
        except queue.Empty:
            if window.poll() is not None:
                break
    sys.exit(f"pages.py: the browser has not finished (exit code {window.poll()})")


@contextmanager
def _opened(browser: str, *options: str):
    """A headless browser that is closed at the end of the block."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        always = ["--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", f"--user-data-dir={profile}"]
        always.append("--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1")
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        with subprocess.Popen([browser, *always, *options], **quiet) as window:
            try:
                yield window
            finally:
                window.terminate()


def _shoot(browser: str, address: str, pages: list[str], folder: Path) -> None:
    """Screenshots of the top of each page, in a frame because Chromium's windows have a minimum width."""
    folder.mkdir(parents=True, exist_ok=True)
    for page in pages:
        for width in WIDTHS:
            _Server.check = (
                f'<body style="margin:0"><iframe src="{page}" style="border:0;width:{width}px;height:1600px">'
            )
            name = f"{page.removesuffix('.html').replace('/', '-')}-{width}.png"
            size = f"--window-size={max(width, 500)},1600"
            with _opened(browser, size, f"--screenshot={folder / name}", f"{address}_check.html") as window:
                window.wait()


def faults(results: list[dict]) -> list[str]:
    """A line per page that scrolls sideways or lacks images."""
    lines = [
        f"{f['page']} is {f['wide']} pixels wide at {f['width']}: {f['past']}"
        for f in results
        if f["wide"] > f["width"]
    ]
    return lines + [f"{f['page']} lacks {f['broken']}" for f in results if f["broken"] and f["width"] == WIDTHS[0]]


def search_faults(site: Path) -> list[str]:
    """A line per search term that does not list its page, or not first."""
    text = (site / "searchindex.js").read_text(encoding="utf-8")
    index = json.loads(text.removeprefix("Search.setIndex(").removesuffix(")"))
    lines = []
    for word, page in WORDS.items():
        documents = set()
        for terms in (index["terms"], index["titleterms"]):
            at = [terms[term] for term in terms if term.startswith(word[: max(4, len(word) - 3)])]
            documents |= {n for numbers in at for n in (numbers if isinstance(numbers, list) else [numbers])}
        if page not in {index["docnames"][n] for n in documents}:
            lines.append(f"a search for {word!r} does not find {page}")
    for word, page in search_words.PAGES.items():
        if page not in {index["docnames"][entry[0]] for entry in index["indexentries"].get(word, [])}:
            lines.append(f"a search for {word!r} does not find {page} first")
    return lines


def head_faults(site: Path) -> list[str]:
    """A line per page whose title or description is missing, long, short, marked up or that of another page."""
    lines, titles, texts = list[str](), dict[str, str](), dict[str, str]()
    for page in pages_of(site):
        head = (site / page).read_text(encoding="utf-8").partition("</head>")[0]
        title = html.unescape(re.search(r"<title>(.*?)</title>", head, re.DOTALL)[1]).lower()
        found = [
            html.unescape(text) for text in re.findall(r'<meta (?:[^>]* )?content="([^"]*)"[^>]*description"', head)
        ]
        found += [html.unescape(text) for text in re.findall(r'<meta [^>]*description" content="([^"]*)"', head)]
        if len(found) != 2 or found[0] != found[1]:
            lines.append(f"{page} has the descriptions {found}, instead of one for engines and previews")
            continue
        text = found[0]
        if not DESCRIPTION[0] <= len(text) <= DESCRIPTION[1] or text[-1] != "." or MARKUP.search(text):
            lines.append(
                f"{page} needs a description of {DESCRIPTION[0]} to {DESCRIPTION[1]} plain characters: {text!r}"
            )
        for seen, own, what in ((titles, title, "title"), (texts, text.lower(), "description")):
            if (other := seen.setdefault(own, page)) != page:
                lines.append(f"{page} has the {what} of {other}: {own!r}")
    return lines


def sitemap_faults(site: Path) -> list[str]:
    """A line per page that the sitemap lacks, or that it lists and the site lacks."""
    listed = re.findall(r"<loc>https://[^/]+/[^/]+/(.*?)</loc>", (site / "sitemap.xml").read_text(encoding="utf-8"))
    pages = pages_of(site)
    lines = [f"sitemap.xml lacks {page}" for page in sorted({*pages} - {*listed})]
    return lines + [f"sitemap.xml lists {page}, which does not exist" for page in sorted({*listed} - {*pages})]


def gallery_faults(site: Path) -> list[str]:
    """A line per thumbnail of the gallery that opens no page."""
    paragraphs = re.findall(r"<p>(.*?)</p>", (site / "gallery.html").read_text(encoding="utf-8"), re.DOTALL)
    thumbnails = [text for text in paragraphs if 'loading="lazy"' in text]
    lines = [f"gallery.html has a thumbnail without a link: {text}" for text in thumbnails if "<a " not in text]
    return lines if thumbnails else ["gallery.html has no thumbnails"]


def host_faults(site: Path) -> list[str]:
    """A line per page that loads a script, style, picture or frame from another host."""
    lines = []
    for page in pages_of(site):
        tags = re.findall(r"<(?:script|img|iframe|link) [^>]*>", (site / page).read_text(encoding="utf-8"))
        loaded = [
            tag for tag in tags if re.search(r' src="(?:https?:)?//', tag) or ("stylesheet" in tag and '="http' in tag)
        ]
        lines += [f"{page} loads a file from another host: {tag}" for tag in loaded]
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("site", type=Path, help="the folder of the built site")
    parser.add_argument("--shots", type=Path, metavar="FOLDER")
    options = parser.parse_args()
    checks = search_faults, gallery_faults, head_faults, sitemap_faults, host_faults
    lines, browser = [line for check in checks for line in check(options.site)], chromium()
    if browser is None:
        print("pages.py: NO CHROMIUM, so widths and pictures are not checked", file=sys.stderr)
    else:
        lines += faults(check_pages(options.site, browser, options.shots))
    print(*lines, sep="\n", end="\n" * bool(lines))
    return bool(lines)


if __name__ == "__main__":
    sys.exit(main())
