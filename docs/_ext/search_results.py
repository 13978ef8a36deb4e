"""What search engines and previews of links show: the front page's title, a description of each page, and sitemap.xml.

A page is described by the first sentences of its text, a page of the reference by its names, and the page of a command
by its help. descriptions.txt has a sentence for each page that begins with something else.
"""

import re
from html import escape
from pathlib import Path

import api_summary
from docutils import nodes
from help import help_text
from sphinx.util import logging

from antumbra.base.command_registry import COMMANDS

LOG = logging.getLogger(__name__)
TITLE = "Antumbra: exact shadows, sun hours and lines of sight in Python"
SHORTEST, LONGEST = 50, 160  # characters of a description
SITEMAP = "sitemap.xml"
SENTENCES = dict(
    line.split(": ", 1)
    for line in Path(__file__).with_name("descriptions.txt").read_text(encoding="utf-8").splitlines()
)
"""Page -> its description."""

_APART = nodes.table, nodes.figure, nodes.Admonition, nodes.definition_list, nodes.footnote, nodes.citation
_STOP = re.compile(r"(?<=[\w)\]”’\"'`%])[.?!](?=\s+[A-Z`“]|$)")
_BEGIN = re.compile(r"What it (?:does|shows)\. ")  # of design notes
_LEFT_OUT = re.compile(r"Open in Colab|.* explains the methods? in full\.")  # sentences
_END = re.compile(r"When |Scene: |What it costs|The papers? ")  # the sentence that follows a description


def sentences(text: str) -> list[str]:
    """The sentences of a text."""
    ends = [match.end() for match in _STOP.finditer(text)]
    return [text[a:b].strip() for a, b in zip([0, *ends], ends)]


def joined(parts: list[str]) -> str:
    """As many of the first sentences as fit; empty unless the first fits."""
    found = ""
    for part in parts:
        longer = f"{found} {part}".strip()
        if len(longer) > LONGEST:
            break
        found = longer
    return found


def of_text(doctree: nodes.document) -> str:
    """The first sentences of a page."""
    parts = list[str]()
    for paragraph in doctree.findall(nodes.paragraph):
        if _is_apart(paragraph):
            continue
        for sentence in sentences(_BEGIN.sub("", " ".join(paragraph.astext().split()))):
            if _END.match(sentence) or len(" ".join(parts)) > LONGEST:
                return joined(parts)
            if not _LEFT_OUT.match(sentence):
                parts.append(sentence)
    return joined(parts)


def _is_apart(node: nodes.Node) -> bool:
    """Whether a paragraph is part of a table, a caption or the like."""
    if node.get("classes"):
        return True
    while (node := node.parent) is not None:
        if isinstance(node, _APART):
            return True
    return False


def of_names(app, page: str) -> str:
    """What a page of the reference describes: its names, and what the first of them is."""
    objects = app.env.domains["py"].objects
    names = api_summary.names_of(objects, app.env.toctree_includes.get(page) or [page])
    tops = [name for name in names if not api_summary.is_member(name, objects)] or names
    first, *others = [api_summary.short(name, objects) for name in tops]
    text = f"{first}: {api_summary.summary_of(tops[0])}".replace("`", "")
    shown = list[str]()
    for each in others:
        if len(f"{text} Also {', '.join([*shown, each])}.") <= LONGEST:
            shown.append(each)
    return f"{text} Also {', '.join(shown)}." if shown else text


def of_command(command: str) -> str:
    """What a command does."""
    first, *others = sentences(" ".join(help_text(command).split("\n\n")[1].split()))
    return joined([f"antumbra {command}: {first}", *others, "All options, with their defaults and units."])


def description(app, page: str, doctree: nodes.document) -> str:
    """The description of a page."""
    folder, _, name = page.rpartition("/")
    if page in SENTENCES:
        return SENTENCES[page]
    if folder == "api":
        return of_names(app, page)
    if folder == "cli" and name in COMMANDS:
        return of_command(name)
    return f"{'Design note. ' * (folder == 'design')}{of_text(doctree)}"


def describe(app, page, template, context, doctree):
    """Set the description of a page, before tags are made of it."""
    context["site_title"] = TITLE
    if doctree is not None:
        text = description(app, page, doctree)
        if not SHORTEST <= len(text) <= LONGEST:
            LOG.warning("the description has %d characters; write one into descriptions.txt", len(text), location=page)
        preview = {"og:description": text} | ({"og:title": TITLE} if page == app.config.root_doc else {})
        context["meta"] = {**(context.get("meta") or {}), **preview}
        context["metatags"] = f'{context.get("metatags", "")}<meta name="description" content="{escape(text)}">\n'


def write_sitemap(app, exception) -> None:
    """List the addresses of all pages."""
    if exception is None and app.builder.format == "html":
        base = app.config.html_baseurl
        pages = sorted(app.env.found_docs)
        urls = [f"<url><loc>{escape(base + app.builder.get_target_uri(page))}</loc></url>" for page in pages]
        head = '<?xml version="1.0" encoding="utf-8"?>\n<urlset xmlns="http://www.sitemaps.org/schemas/sitemap/0.9">'
        Path(app.outdir, SITEMAP).write_text("\n".join([head, *urls, "</urlset>\n"]), encoding="utf-8")


def setup(app):
    app.connect("html-page-context", describe, priority=100)
    app.connect("build-finished", write_sitemap)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
