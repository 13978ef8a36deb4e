"""The registry of commands: each entry names a command that exists, and says what the command says of itself."""

import pytest

import antumbra as at
from antumbra.base.command_registry import COMMANDS
from antumbra.base.wings import named
from antumbra.city.sensor_study import SensorStudy
from antumbra.cli.app import program
from antumbra.cli.study_run import StudyCommand
from study_cases import study_cases


@pytest.mark.parametrize("name", COMMANDS)
def test_the_registry_has_the_first_line_of_the_help_of_each_command(name):
    assert COMMANDS[name].help == COMMANDS[name].function(name).__doc__.strip().split("\n\n")[0]


def test_the_program_lists_the_registered_commands_in_their_order():
    assert [command.name for command in program(frozenset()).registered_commands][:-1] == list(COMMANDS)


def test_kernels_of_studies_are_those_of_example_calls():
    examples = {name: named(command.kernels) for name, command in COMMANDS.items() if command.kernels}
    assert set(examples) >= {"sun", "skyline", "viewshed"} and all(examples.values())
    calls = [example for of_study in examples.values() for example in of_study.items()]
    assert len(calls) == len(dict(calls)) and all(callable(call) for _, call in calls)


def test_every_study_is_registered():
    """Each class of a study's command belongs to the module of a registered command."""
    for name, command in COMMANDS.items():
        command.function(name)
    classes = {*StudyCommand.__subclasses__(), *SensorStudy.__subclasses__()} - {SensorStudy}
    modules = {command.module for command in COMMANDS.values()}
    assert len(classes) >= 9 and {each.__module__ for each in classes} <= modules


def test_cases_of_studies_name_public_functions_and_registered_commands():
    cases = study_cases()
    assert cases and {case.function for case in cases} <= set(at.__all__)
    assert {case.command for case in cases} - {""} <= COMMANDS.keys()
