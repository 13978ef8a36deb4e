"""Charts and diagrams, which dark pages show inverted and narrow screens scroll: pictures on a mostly white ground.

Pictures with a white border only, such as renders with titles, become sheets: dark pages frame them. A diagram whose
halves stand alone (scripts/paper_diagrams.py) is two parts side by side, which phones show one below the other.
"""

from functools import cache
from pathlib import Path

import numpy as np
from docutils import nodes
from PIL import Image

WHITE = 250  # of 255
MOSTLY = 0.55  # share of white pixels of a chart
_SMALL = 400  # pixels of a side of the copy that is looked at


@cache
def kind_of(path: Path) -> str | None:
    """``"chart"``, ``"sheet"``, or None for another picture."""
    if path.suffix == ".svg":
        return "chart" if 'fill="white"' in path.read_text(encoding="utf-8")[:600] else None
    if path.suffix != ".png":
        return None
    with Image.open(path) as picture:
        flat = Image.new("RGBA", picture.size, "white")
        flat.alpha_composite(picture.convert("RGBA"))
    flat.thumbnail((_SMALL, _SMALL), Image.Resampling.NEAREST)
    white = np.asarray(flat)[..., :3].min(-1) >= WHITE
    border = np.concatenate([white[0], white[-1], white[:, 0], white[:, -1]])
    if border.mean() < 0.9:
        return None
    return "chart" if white.mean() > MOSTLY else "sheet"


def mark(app, doctree, page: str) -> None:
    """Put each chart into a container that scrolls, and give charts and sheets their class."""
    for image in list(doctree.findall(nodes.image)):
        path = Path(app.srcdir, image["uri"])
        kind = kind_of(path) if path.is_file() else None
        if kind is None:
            continue
        image["classes"].append(kind)
        if isinstance(image.parent, nodes.paragraph | nodes.section):
            parts = halves(image) if has_halves(path) else [image]
            frame = nodes.container(classes=["wide-chart" if len(parts) == 1 else "halves"])
            image.replace_self(frame)
            frame += parts


def has_halves(path: Path) -> bool:
    """Whether a diagram is marked as one of two halves."""
    return path.suffix == ".svg" and " data-halves" in path.read_text(encoding="utf-8")[:600]


def halves(image: nodes.image) -> list[nodes.container]:
    """The left and the right half of a diagram: the whole picture twice, of which each part shows one half."""
    right = image.deepcopy()
    right["alt"] = ""  # the first has the text for both
    return [nodes.container("", image.deepcopy()), nodes.container("", right)]


def setup(app):
    app.connect("doctree-resolved", mark)
    return {"parallel_read_safe": True}
