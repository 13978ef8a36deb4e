"""Methods of other packages: `examples/plugin` is installed, and found by name, by `auto` and by commands."""

import json
import os
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from antumbra.base.errors import InputError
from antumbra.engine import method_registry
from antumbra.engine.auto.cost_model import strategies
from antumbra.engine.method_registry import KINDS, TRACERS, Builder, Cost, Tracer, TreelessCost, register
from repository import ROOT

PROGRAM = """
import json
import sys

import numpy as np

import antumbra as at
from antumbra.engine import plan

answer = {"loaded by import": "example_plugin" in sys.modules}
floor = [[[-5, 0, -5], [5, 0, -5], [5, 0, 5]], [[-1, 1, -1], [1, 1, -1], [1, 1, 1]]]
scene, room = at.Scene.from_arrays(np.array(floor, float)), at.procedural("atrium", triangles=2000)
lamp = at.QuadLight((-1, 4, -1), (2, 0, 0), (0, 0, 2))
view = room.cameras[0].resized(48, 40)
points, up = np.random.default_rng(0).uniform((-2, 0, -2), (2, 0.5, 2), (500, 3)), [0, 1, 0]


def seen(light, **options):
    return at.visibility(scene, points, light, normals=np.tile(up, (500, 1)), spp=4, **options).bits


at.visibility(scene, [0, 0.5, 0], lamp, spp=1)
answer["loaded by one ray"] = "example_plugin" in sys.modules
sky = at.AmbientOcclusion()
chosen = seen(sky)
seen(sky)
choices = scene.engine.accelerated().chosen.choices
answer["choices"] = [(choice.strategy, choice.reason) for choice in choices]
answer["papers"] = "antumbra.lab.papers.published_methods" in sys.modules
answer["chosen bits"] = bool((chosen == seen(sky, plan="bsah+single")).all() and 0 < np.count_nonzero(chosen) < 500)

plans = ["median+every-triangle", "median+wide", "median+refit+multifrusta", "grid32+median+packet16", "median+auto"]
named = at.render(room, view, lamp, spp=4, plan="bsah+single").bits[0]
answer["plans"] = {}
for text in plans:
    answer["plans"][text] = bool((at.render(room, view, lamp, spp=4, plan=text).bits[0] == named).all())
answer["both outcomes"] = bool(named.any() and (named == 0).any())
answer["covered"] = [str(each) for each in plan.covering_plans(papers=True)]

from example_plugin import Window

window, quad = Window((0, 3, -2), 0.0, 2.0, 1.0), at.QuadLight((-1, 2.5, -2), (2, 0, 0), (0, 1, 0))
images = [at.render(room, view, each, spp=4).image for each in (window, quad)]
answer["window"] = bool((images[0] == images[1]).all() and images[0].any())
try:
    at.render(room, view, lamp, plan="median+every-triangel")
except at.InputError as error:
    answer["typo"] = str(error)
print(json.dumps(answer))
"""


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """A folder with the plugin, installed as from a package index."""
    for tool in "pip", "hatchling":
        pytest.importorskip(tool, reason=f"no {tool}: the plugin in examples/plugin is NOT installed")
    source, target = tmp_path_factory.mktemp("source") / "plugin", tmp_path_factory.mktemp("site")
    shutil.copytree(ROOT / "examples" / "plugin", source)
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--no-index", "--disable-pip-version-check"]
    command = [sys.executable, "-m", "pip", "install", *options, "--target", str(target), str(source)]
    subprocess.run(command, check=True, capture_output=True)
    return target


def _run(site, *command):
    settings = {**os.environ, "PYTHONPATH": os.pathsep.join([str(site), *sys.path])}
    done = subprocess.run([sys.executable, *command], capture_output=True, text=True, env=settings)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def found(site):
    return json.loads(_run(site, "-c", PROGRAM))


def test_auto_considers_the_tracer_of_an_installed_package_once_it_chooses(found):
    assert not found["loaded by import"] and not found["loaded by one ray"]
    assert found["choices"] == [["every-triangle", "prediction"]] and found["chosen bits"]
    assert not found["papers"]  # these tracers state no cost, so `auto` does not load them


def test_methods_of_an_installed_package_combine_with_others_by_name(found):
    assert len(found["plans"]) == 5 and all(found["plans"].values()) and found["both outcomes"]
    assert {"bsah+every-triangle", "median+single"} <= set(found["covered"])


def test_a_light_of_another_package_gives_the_image_of_an_equal_one(found):
    assert found["window"]


def test_a_misspelt_method_of_another_package_is_refused_with_the_names(found):
    assert "unknown part 'every-triangel'; did you mean 'every-triangle'" in found["typo"]
    assert re.search(r"builders: bsah, .*median;.* tracers: auto, single, .*every-triangle\)", found["typo"])


def test_commands_list_the_methods_of_an_installed_package(site):
    for options in [], ["--papers"]:
        answer = json.loads(_run(site, "-m", "antumbra", "plans", "--json", *options))
        kinds = {method["name"]: method["kind"] for method in answer["methods"]}
        assert (kinds["median"], kinds["every-triangle"]) == ("builder", "tracer")
        assert ("packet256" in kinds) == bool(options) and "median+every-triangle" in answer["plans"]


def test_commands_understand_the_light_of_an_installed_package(site, tmp_path):
    images = []
    for light in "window:0,3,-2:0:2:1@30", "quad:0,3,-2:2,0,0:0,1,0@30":
        path = tmp_path / f"{light.partition(':')[0]}.png"
        options = ["--light", light, "--size", "48x32", "--spp", "4", "-o", str(path), "--quiet"]
        _run(site, "-m", "antumbra", "render", "procedural:atrium?triangles=2k", *options)
        images.append(np.asarray(Image.open(path)))
    np.testing.assert_array_equal(*images)
    assert np.unique(images[0]).size > 10


def test_a_wrong_light_is_refused_with_all_kinds(site):
    settings = {**os.environ, "PYTHONPATH": os.pathsep.join([str(site), *sys.path])}
    for light, words in (
        ("lamp:1", "quad:CX.* window:CX,CY,CZ"),
        ("window:0,0:0:1:1", "centre"),
        ("window:0", "write w"),
    ):
        command = [sys.executable, "-m", "antumbra", "render", "example:mill", "--light", light]
        done = subprocess.run(command, capture_output=True, text=True, env=settings)
        assert done.returncode == 2 and re.search(words, done.stderr.replace("\n", " ")), done.stderr


# --- The registry -----------------------------------------------------------------------------------------------------


def test_there_is_one_registry_of_tracers():
    assert KINDS["trace"][1] is TRACERS and next(iter(TRACERS)) == "auto"
    assert all(isinstance(tracer, Tracer) and tracer.description for tracer in TRACERS.values())
    assert set(strategies()) == {name for name, tracer in TRACERS.items() if isinstance(tracer.cost, Cost)}
    assert [name for name, tracer in TRACERS.items() if isinstance(tracer.cost, TreelessCost)] == ["cones"]


def test_auto_alone_chooses_and_states_no_cost():
    assert [name for name, tracer in TRACERS.items() if tracer.chooses] == ["auto"] and TRACERS["auto"].cost is None


@pytest.mark.parametrize(
    "field, name, method, words",
    [
        ("tracer", "mine", Tracer(), "field .*cull.*build.*optimise.*update.*trace"),
        ("trace", "mine", Tracer, "tracer 'mine'"),
        ("trace", "mine", Builder(np.zeros, "", ""), "tracer 'mine'"),
        ("build", "mine", np.zeros, "builder 'mine'"),
        ("trace", "single", Tracer(), "'single' cannot be the name of a tracer: it is taken"),
        ("trace", "bsah", Tracer(), "'bsah' cannot be the name of a tracer: it is taken"),
        ("trace", "a+b", Tracer(), "'a.b' cannot be the name of a tracer: .* plus sign"),
    ],
)
def test_what_is_no_method_is_not_registered(field, name, method, words):
    before = {field: list(registry) for field, (_, registry) in KINDS.items()}
    with pytest.raises(InputError, match=words):
        register(field, name, method)
    assert before == {field: list(registry) for field, (_, registry) in KINDS.items()}


def test_a_registered_method_is_none_of_the_own_ones(monkeypatch):
    monkeypatch.setitem(method_registry._added, "trace", [*method_registry._added["trace"]])
    tracer = Tracer()
    register("trace", "mine", tracer)
    try:
        assert method_registry.find_method("trace", "mine") == ("mine", tracer)
        assert "mine" not in method_registry.own_methods("trace") and "mine" in method_registry.listed_methods("trace")
        assert method_registry.own_methods("build") == method_registry.listed_methods("build")
    finally:
        del TRACERS["mine"]
