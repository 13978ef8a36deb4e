"""Examples in docstrings: what users read in the reference and in `help` prints what it says."""

import doctest
import inspect

import numpy as np
import pytest

import antumbra as at

FINDER = doctest.DocTestFinder(recurse=False)


def documented():
    """(name, function, method or class) of the public names, with what classes inherit."""
    for name in at.__all__:
        thing = getattr(at, name)
        if not getattr(thing, "__module__", "").startswith("antumbra"):
            continue
        yield name, thing
        if inspect.isclass(thing):
            for member, method in inspect.getmembers(thing, callable):
                if not member.startswith("_"):
                    yield f"{name}.{member}", method


EXAMPLES = {name: thing for name, thing in documented() if ">>>" in (inspect.getdoc(thing) or "")}


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_print_what_they_say(name):
    (example,) = FINDER.find(EXAMPLES[name], name, module=False, globs={"at": at, "np": np})
    result = doctest.DocTestRunner().run(example)
    assert result.attempted and not result.failed


MOST_USED = (
    *("load", "procedural", "build_store", "visibility", "line_of_sight", "viewshed", "skyline", "shadow", "sun_hours"),
    *("render", "Renderer", "Frame", "Camera", "bake", "Sensors", "sensors_of", "Table"),
    *("PointLight", "QuadLight", "DiskLight", "SphereLight", "DirectionalLight", "AmbientOcclusion"),
    *("Sky", "PointLights", "DirectionalLights", "virtual_point_lights"),
    *(f"Scene.{name}" for name in ("from_arrays", "occluded", "closest_hit", "contains", "closest_points")),
)


@pytest.mark.parametrize("name", MOST_USED)
def test_what_most_users_call_has_an_example(name):
    assert name in EXAMPLES
