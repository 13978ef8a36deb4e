"""What tests of pages share: their modules in node, the parts of their files, and a scene of two towers on a floor."""

import json
import re
import shutil
import subprocess
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import antumbra as at
from antumbra.web.page_source import PAGE

NODE = shutil.which("node")
needs_node = pytest.mark.skipif(NODE is None, reason="without node, the modules of the page are NOT checked")
needs_linker = pytest.mark.skipif(find_spec("ziglang") is None, reason="without ziglang, pages are NOT checked")
PARTS = Path(__file__).parents[1] / "web" / "page_parts.mjs"
SCENE, DATA, CODE = (
    'script type="application/json" id="scene"',
    'script type="text/plain" id="data"',
    'script id="code"',
)


def asked(folder, *calls):
    """The answers of modules of the page in node."""
    (folder / "calls.json").write_text(json.dumps(calls))
    subprocess.run([NODE, PARTS, PAGE, folder], check=True)
    return json.loads((folder / "answers.json").read_text())


def part_of(page, start):
    """The text of the element of a page whose tag starts so."""
    return re.search(rf"<{start}[^>]*>(.*?)</", page, re.S)[1]


def towers():
    """A floor of 80 m with two towers, named, and z up: {name of a tower: its mesh}."""
    c = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (0, 1)], np.float64)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (1, 5, 7, 3)]
    box = np.array([c[list(three)] for a, b, d, e in quads for three in ((a, b, d), (a, d, e))])
    floor = np.array([[[-40, -40, 0], [40, -40, 0], [40, 40, 0]], [[-40, -40, 0], [40, 40, 0], [-40, 40, 0]]], float)
    places = {"Tower A": ((5, 5, 30), (-12, -14, 0)), "Tower B": ((4, 4, 45), (14, -10, 0))}
    return {"floor": floor, **{name: box * size + shift for name, (size, shift) in places.items()}}


def scene_of_towers(folder):
    """The towers from an OBJ file, whose materials are the objects."""
    colours = "".join(f"newmtl {name.replace(' ', '_')}\nKd 0.7 0.6 0.5\n" for name in towers())
    (folder / "towers.mtl").write_text(colours)
    lines, n = ["mtllib towers.mtl"], 0
    for name, corners in towers().items():
        lines.append(f"usemtl {name.replace(' ', '_')}")
        lines += [f"v {x} {y} {z}" for x, y, z in corners.reshape(-1, 3)]
        lines += [f"f {n + i + 1} {n + i + 2} {n + i + 3}" for i in range(0, 3 * len(corners), 3)]
        n += 3 * len(corners)
    path = folder / "towers.obj"
    path.write_text("\n".join(lines) + "\n")
    return at.load(path, up="z")
