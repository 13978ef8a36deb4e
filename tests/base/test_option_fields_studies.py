"""The options of jobs stand once: keywords, their descriptions and commands have all of them."""

import inspect
from dataclasses import fields

import pytest

import antumbra as at
from antumbra.baking.bake_options import BakeOptions
from antumbra.base.field_docs import field_texts
from antumbra.base.option_fields import option_of, type_text
from antumbra.city.shadow.shadow_options import ShadowOptions
from antumbra.city.sight.viewshed_options import ViewshedOptions
from antumbra.city.sun.sun_options import SunOptions
from antumbra.cli.app import program
from antumbra.cli.options import derived_options
from antumbra.datasets.dataset_options import DatasetOptions

JOBS = {
    "bake": (at.bake, BakeOptions),
    "dataset": (at.dataset, DatasetOptions),
    "shadow": (at.shadow, ShadowOptions),
    "sun": (at.sun_hours, SunOptions),
    "viewshed": (at.viewshed, ViewshedOptions),
}
COMMANDS = {command.name or command.callback.__name__: command.callback for command in program().registered_commands}


@pytest.mark.parametrize("name", JOBS)
def test_functions_and_commands_have_all_options(name):
    function, options = JOBS[name]
    parameters, doc = inspect.signature(function).parameters, inspect.getdoc(function)
    assert len(fields(options)) >= 10
    for field in fields(options):
        assert parameters[field.name].default == field.default
        assert f"\n{field.name} : " in doc
        if parameters[field.name].kind is inspect.Parameter.KEYWORD_ONLY:
            origin = option_of(field).origin
            text = field_texts(options).get(field.name) or field_texts(origin)[field.name]
            assert f"{field.name} : {type_text(field)} {text}" in " ".join(doc.split())
    words = inspect.signature(COMMANDS[name]).parameters
    assert {each.name for each in derived_options(options)} <= words.keys()


@pytest.mark.parametrize("name", JOBS)
def test_options_are_checked_and_stay_the_same_when_checked_again(name):
    _, options = JOBS[name]
    checked = options()
    assert options(**{field.name: getattr(checked, field.name) for field in fields(options)}) == checked
    with pytest.raises(at.InputError, match=r"^threads is 0"):
        options(threads=0)
    with pytest.raises(at.InputError, match="plan"):
        options(plan="none such")
