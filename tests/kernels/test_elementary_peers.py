"""No answer depends on functions whose last bits differ between systems and processors."""

import ast
from pathlib import Path

import antumbra

PACKAGE = Path(antumbra.__file__).parent
FUNCTIONS = {
    *("sin", "cos", "tan", "arcsin", "arccos", "arctan", "arctan2", "asin", "acos", "atan", "atan2"),
    *("sinh", "cosh", "tanh", "exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "power", "pow", "float_power"),
    *("hypot", "cbrt", "dist", "logaddexp", "sinc", "geomspace", "logspace"),
}
MODULES = {"np", "numpy", "math"}
FREE = {
    "engine/auto/cost_model.py": "choices between plans, which all give the same bits",
    "engine/auto/strategies.py": "choices between plans",
    "trace/tracer_cost.py": "choices between plans",
    "engine/small_scenes.py": "a scene for recording kernels",
    "city/tables/map_scale.py": "ticks of legends",
    "city/sheets/map_frame.py": "arrows and scale bars on map sheets",
    "city/sheets/map_labels.py": "places of labels on map sheets",
    "picture/heat_maps.py": "ticks of legends",
    "scene/lights.py": "the limit of distances",
    "viewer/proxy_mesh.py": "the page of the viewer",
    "viewer/viewer_model.py": "the page of the viewer",
}


def uses(text):
    """(line, name) of each use of one of `FUNCTIONS` of NumPy or the C library."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and node.attr in FUNCTIONS:
            if isinstance(node.value, ast.Name) and node.value.id in MODULES:
                yield node.lineno, node.attr
        elif isinstance(node, ast.ImportFrom) and node.module in MODULES:
            yield from ((node.lineno, each.name) for each in node.names if each.name in FUNCTIONS)


def test_functions_of_numpy_and_of_the_c_library():
    found = {}
    for path in sorted(PACKAGE.rglob("*.py")):
        name = path.relative_to(PACKAGE).as_posix()
        if not name.startswith("lab/papers/") and (lines := list(uses(path.read_text(encoding="utf-8")))):
            found[name] = lines
    wrong = {name: lines for name, lines in found.items() if name not in FREE}
    assert not wrong, f"use antumbra.kernels.elementary: {wrong}"
    assert found.keys() == FREE.keys()


def test_uses_are_found():
    text = "import numpy as np\nfrom math import atan2 as f\ny = np.log(3)\nz = elementary.log(3)\n"
    assert list(uses(text)) == [(2, "atan2"), (3, "log")]
