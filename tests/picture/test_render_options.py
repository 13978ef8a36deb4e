"""The options of a picture stand once: keywords, documents, records and digests have all of them."""

import ast
import inspect
from dataclasses import FrozenInstanceError, fields, replace

import numpy as np
import pytest

import antumbra as at
from antumbra.base.field_docs import field_texts
from antumbra.base.option_fields import deciding_fields, field_values, split_keywords, type_text
from antumbra.picture.render_options import EngineOptions, RenderKeywords, RenderOptions, options_of
from repository import ROOT

SOURCE = ROOT / "src" / "antumbra"
NAMES = [field.name for field in fields(RenderOptions)]

OTHERS = {
    "spp": 4, "time": 1.5, "counters": True, "sampler": "halton", "seed": 3, "cull_faces": "back", "filter": True,
    "antialias": False, "adaptive": 8, "bounce": 2, "bounces": 3, "bounce_step": 4, "ambient": False,
    "background": False, "layers": True, "textures": False, "materials": "diffuse",
    "smooth_normals": False, "ground": -1.5,
}  # fmt: skip
"""Option -> a value that is not the default."""

WRONG = {
    "spp": (1025, "spp is 1025; it must be a whole number from 1 to 1024"),
    "time": ("noon", "time (seconds) is 'noon'; it must be a number"),
    "counters": (1, "counters is 1; it must be True or False"),
    "sampler": ("halto", "sampler is 'halto'; did you mean 'halton'? it must be"),
    "seed": (-1, "seed is -1; it must be a whole number from 0 to 9223372036854775807"),
    "cull_faces": ("left", 'cull_faces is \'left\'; it must be None, "front" or "back"'),
    "filter": ("yes", "filter is 'yes'; it must be True or False"),
    "antialias": (None, "antialias is None; it must be True or False"),
    "adaptive": (0, "adaptive is 0; it must be a whole number from 1 to 1024"),
    "bounce": (1.5, "bounce is 1.5; it must be a whole number from 1 to 1024"),
    "bounces": (65, "bounces is 65; it must be a whole number from 1 to 64"),
    "bounce_step": (3, "bounce_step is 3; it must be 1, 2, 4 or 8"),
    "ambient": (0.12, "ambient is 0.12; it must be True or False"),
    "background": ("white", "background is 'white'; it must be True or False"),
    "layers": (0, "layers is 0; it must be True or False"),
    "textures": ([], "textures is []; it must be True or False"),
    "materials": ("x", 'materials is \'x\'; it must be "pbr" or "diffuse"'),
    "smooth_normals": ("x", "smooth_normals is 'x'; it must be True or False"),
    "ground": (1e31, "ground (height) is 1e+31; it must lie between -1e+30 and 1e+30"),
}
"""Option -> a wrong value, and the beginning of the error."""


@pytest.fixture(scope="module")
def view():
    scene = at.procedural("atrium", triangles=2000)
    return scene, scene.cameras[0].resized(24, 16), scene.lights[0]


def test_the_tables_of_this_test_are_complete():
    assert list(OTHERS) == list(WRONG) == NAMES and len(NAMES) > 10
    assert not [name for name in NAMES if getattr(RenderOptions(), name) == OTHERS[name]]


@pytest.mark.parametrize("function", [at.render, at.Renderer.render, at.RenderOptions])
def test_keywords_are_the_fields(function):
    shown = inspect.signature(function).parameters
    for field in fields(RenderOptions):
        parameter = shown[field.name]
        assert parameter.kind is inspect.Parameter.KEYWORD_ONLY
        assert parameter.default == field.default
        text = " ".join(inspect.getdoc(function).split())
        assert f"{field.name} : {type_text(field)} {field_texts(RenderOptions)[field.name]}" in text
    assert text.index("Parameters -------") < text.index("spp : int") < text.index("Raises")


def test_render_has_the_keywords_of_a_renderer_too():
    own = list(inspect.signature(at.Renderer).parameters.values())[1:]
    shown = inspect.signature(at.render).parameters
    assert [(p.name, p.default) for p in own] == [(f.name, f.default) for f in fields(EngineOptions)]
    assert [shown[p.name].default for p in own] == [p.default for p in own]
    assert {f.name for f in fields(RenderKeywords)} == {*NAMES, *(p.name for p in own)} < shown.keys()


@pytest.mark.parametrize("name", NAMES)
def test_values_are_checked(name):
    value, words = WRONG[name]
    with pytest.raises(at.InputError) as error:
        RenderOptions(**{name: value})
    assert str(error.value).startswith(words) and "\n" not in str(error.value)
    assert getattr(RenderOptions(**{name: OTHERS[name]}), name) == OTHERS[name]


def test_options_are_immutable_and_of_plain_types():
    options = RenderOptions(spp=np.int64(8), counters=np.bool_(True), time=np.float32(0.5), ground=None)
    assert [type(value) for value in (options.spp, options.counters, options.time)] == [int, bool, float]
    assert options.ground is False and options == RenderOptions(spp=8, counters=True, time=0.5)
    with pytest.raises(FrozenInstanceError):
        options.spp = 9


def test_options_and_keywords_give_the_same_picture(view):
    asked = {"spp": 2, "sampler": "hammersley", "filter": True, "adaptive": 4}
    one, other = at.render(*view, **asked), at.render(*view, options=RenderOptions(**asked))
    np.testing.assert_array_equal(one.image, other.image)
    np.testing.assert_array_equal(one.bits, other.bits)
    again = at.Renderer(view[0]).render(
        *view[1:], options=RenderOptions(spp=9, filter=True), **asked | {"filter": False}
    )
    assert (again.bits[0] == one.bits[0]).all() and (again.image != one.image).any()


def test_wrong_keywords_are_errors_of_the_function(view):
    with pytest.raises(TypeError, match=r"render\(\) got an unexpected keyword argument 'sppp'"):
        at.render(*view, sppp=4)
    with pytest.raises(TypeError, match=r"render\(\) got an unexpected keyword argument 'plan'"):
        at.Renderer(view[0]).render(*view[1:], plan="auto")
    with pytest.raises(at.InputError, match=r"options must be an antumbra\.RenderOptions, not int"):
        at.render(*view, options=16)
    with pytest.raises(at.InputError, match="spp is 0"):
        at.render(*view, options=RenderOptions(), spp=0)


def test_digests_have_all_that_decides():
    usual = deciding_fields(RenderOptions())
    left_out = {name for name in NAMES if name not in usual}
    assert left_out == {"counters", "layers"}  # they add to a frame, and change none of its pixels
    for name in NAMES:
        changed = replace(RenderOptions(), **{name: OTHERS[name]})
        assert (deciding_fields(changed) == usual) == (name in left_out)
        assert field_values(changed) != field_values(RenderOptions())


def test_keywords_are_split():
    assert split_keywords({"spp": 1, "plan": "auto"}, EngineOptions) == ({"plan": "auto"}, {"spp": 1})
    assert options_of(None, {"spp": 1}) == RenderOptions(spp=1) == options_of(RenderOptions(spp=2), {"spp": 1})


def named_together(tree: ast.AST) -> list[set[str]]:
    """The names that parameters, fields, keywords, or texts of one function, class, call or list have."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.Lambda)):
            given = node.args
            found.append({each.arg for each in (*given.posonlyargs, *given.args, *given.kwonlyargs)})
        elif isinstance(node, ast.ClassDef):
            found.append({each.target.id for each in node.body if isinstance(each, ast.AnnAssign)})
        elif isinstance(node, ast.Call):
            found.append({each.arg for each in node.keywords if each.arg})
        elif isinstance(node, (ast.Tuple, ast.List, ast.Set, ast.Dict)):
            parts = node.keys if isinstance(node, ast.Dict) else node.elts
            found.append(
                {each.value for each in parts if isinstance(each, ast.Constant) and isinstance(each.value, str)}
            )
    return found


def test_no_other_file_spells_out_the_options():
    """Six of their names in one place are a second list of them, which the next option would be missing from."""
    spelled = lambda text: any(len(names & {*NAMES}) >= 6 for names in named_together(ast.parse(text)))
    texts = {path.relative_to(SOURCE).as_posix(): path.read_text() for path in SOURCE.rglob("*.py")}
    some = {path: text for path, text in texts.items() if sum(name in text for name in NAMES) >= 6}  # parsing is slow
    places = {path for path, text in some.items() if spelled(text)}
    assert places == {"picture/render_options.py"}
