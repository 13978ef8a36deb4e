r"""Long commands continue on further lines, broken by " \" before options: whole on the page, and in a shell.

Commands in blocks of text, which the checks of examples do not run, look like others. On narrow screens, options, dates
and other words with hyphens stay whole, because browsers would break lines after each hyphen, " \" is not shown,
because lines break anyway, and each command is a `.line`, whose further lines hang.
"""

import re

from docutils import nodes

WIDEST = 86  # characters of a line of code beside both sidebars
LONGEST = 32  # characters of a word that stays whole on the narrowest screens

_OPTION = re.compile(r""" (?=--?[a-z])(?=(?:[^"']|"[^"]*"|'[^']*')*$)""")  # the space before one outside quotes

_COMMAND = re.compile(r"antumbra [a-z]|pip [a-z]|python \S+\.py")  # the beginning of a block of commands
_SHELL = re.compile(r'(<div class="highlight-sh .*?<pre>)(.*?)(?=</pre>)', re.DOTALL)
_CONTINUED = re.compile(r'<span class="se">\\</span>\n(?: +|<span class="w"> +</span>)?')
_JOINED = "\0"  # stands for the end of a line that the next one continues
_TAG_OR_WORD = re.compile(r"<[^>]*>|(?:&#?\w+;|[^\s<>&])+")
_NAME = re.compile(rf'<span class="pre">(?=[^<]{{1,{LONGEST}}}</span>)')


def broken(line: str) -> str:
    """A command in lines of at most `WIDEST` characters, where its options allow; comments keep theirs whole."""
    if len(line) <= WIDEST or "#" in line:
        return line
    first, *options = _OPTION.split(line)
    lines = [first]
    for option in options:
        if len(lines[-1]) + len(option) + 3 > WIDEST:
            lines.append(f"    {option}")
        else:
            lines[-1] += f" {option}"
    return " \\\n".join(lines)


def break_commands(app, doctree):
    """Break the long lines of shell blocks."""
    for block in doctree.findall(nodes.literal_block):
        if block.get("language") in ("text", "default", None) and _COMMAND.match(block.astext()):
            block["language"] = "sh"
        if block.get("language") in ("sh", "bash"):
            text = "\n".join(map(broken, block.astext().split("\n")))
            block.rawsource = text
            block.children = [nodes.Text(text)]


def keep_whole(body: str) -> str:
    """The HTML of a page whose short words with hyphens, in commands and in code within text, do not break."""
    body = _SHELL.sub(lambda block: block[1] + _in_shell(block[2]), body)
    return _NAME.sub('<span class="pre whole">', body)


def _in_shell(code: str) -> str:
    code = _CONTINUED.sub(_continued, _TAG_OR_WORD.sub(_whole, code))
    return "".join(map(_line, code.splitlines(keepends=True))).replace(_JOINED, "\n")


def _continued(match: re.Match) -> str:
    return f'<span class="continued">{match[0].replace(chr(10), _JOINED)}</span>'


def _line(text: str) -> str:
    """A line as an element of its own, unless one of its elements goes on in the next line."""
    return f'<span class="line">{text}</span>' if text.count("<span") == text.count("</span>") else text


def _whole(match: re.Match) -> str:
    word = match[0]
    hyphens = "-" in word and not word.startswith("<") and len(word) <= LONGEST
    return f'<span class="whole">{word}</span>' if hyphens else word


def mark_words(app, page, template, context, doctree):
    """Keep the words of a page whole."""
    if "body" in context:
        context["body"] = keep_whole(context["body"])


def setup(app):
    app.connect("doctree-read", break_commands)
    app.connect("html-page-context", mark_words)
    return {"parallel_read_safe": True}
