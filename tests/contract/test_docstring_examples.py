"""Examples in docstrings: what users read in the reference and in `help` prints what it says."""

import doctest
import inspect

import numpy as np
import pytest

import antumbra as at
from antumbra.integrations.open3d import RaycastingScene

FINDER = doctest.DocTestFinder(recurse=False)


def documented():
    """(name, function, method or class) of the public names, with what classes inherit."""
    yield "examples.temple", at.examples.temple
    yield "RaycastingScene", RaycastingScene
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


PACKAGES = {"trimesh_nearest": "trimesh", "trimesh_ray": "trimesh"}
"""Packages of other libraries that an example shows in use."""


@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_print_what_they_say(name):
    if name in PACKAGES:
        pytest.importorskip(PACKAGES[name])
    (example,) = FINDER.find(EXAMPLES[name], name, module=False, globs={"at": at, "np": np})
    result = doctest.DocTestRunner().run(example)
    assert result.attempted and not result.failed


MOST_USED = (
    *("load", "procedural", "build_store", "visibility", "line_of_sight", "viewshed", "skyline", "shadow", "sun_hours"),
    *("visible_share", "visibility_matrix", "view_factors", "module_shading", "sun_calendar", "suns_of", "Place"),
    *("dataset", "Engine", "Hit", "CityModel", "trimesh_ray", "pvlib_shading", "RaycastingScene"),
    *("render", "Renderer", "Frame", "Camera", "bake", "Sensors", "sensors_of", "Table"),
    *("PointLight", "QuadLight", "DiskLight", "SphereLight", "DirectionalLight", "AmbientOcclusion"),
    *("Sky", "PointLights", "DirectionalLights", "virtual_point_lights"),
    *(f"Scene.{name}" for name in ("from_arrays", "occluded", "closest_hit", "contains", "closest_points")),
)


@pytest.mark.parametrize("name", MOST_USED)
def test_what_most_users_call_has_an_example(name):
    assert name in EXAMPLES
