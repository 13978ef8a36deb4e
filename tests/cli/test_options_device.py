"""The option --device: on every command with a plan, for the whole command, and never against the plan."""

from pathlib import Path
from typing import Any

import pytest
import typer

from antumbra.cli.app import program
from antumbra.devices.device import OutOfDeviceMemory
from antumbra.trace.device.device_surfaces import DeviceSurfaces

COMMANDS: Any = typer.main.get_command(program())


def options_of(name):
    return {option for param in COMMANDS.commands[name].params for option in param.opts}


def test_every_command_with_one_plan_takes_a_device():
    plans = {
        name
        for name, command in COMMANDS.commands.items()
        if any(param.name == "plan" and not param.multiple for param in command.params if hasattr(param, "multiple"))
    }
    assert {"render", "sun", "bake", "viewshed", "visible", "matrix"} <= plans
    assert {name for name in plans if "--device" in options_of(name)} == plans
    assert not any("--device" in options_of(name) for name in COMMANDS.commands.keys() - plans)


def test_a_picture_on_a_device_is_that_of_the_cpu_and_says_who_traced(cli, square_obj):
    picture = "render", square_obj, "--size", 8, "--spp", 4
    cli(*picture, "-o", "cpu.png")
    out = cli(*picture, "-o", "device.png", "--device", "host", "--explain-plan").out
    assert "bsah+device:host:0" in out and "The device host:0 found what the camera sees and traced" in out
    assert Path("cpu.png").read_bytes() == Path("device.png").read_bytes()


DECIDED = "decided the few tests that need exact arithmetic"
FOUND, TRACED = "found what the camera sees", "traced the shadow rays; the CPU"
SENTENCES = {
    (): f"{FOUND} and {TRACED} {DECIDED} and shaded.",
    ("--adaptive",): f"{FOUND} and {TRACED} found the sub-pixels of edges, {DECIDED}, and shaded.",
    ("--bounce", 1): f"{FOUND} and {TRACED} traced bounced rays, {DECIDED}, and shaded.",
    ("--camera", "panorama"): f"{TRACED} {FOUND}, {DECIDED}, and shaded.",
    ("full",): f"{TRACED} {FOUND}, {DECIDED}, and shaded.",
}


@pytest.mark.parametrize("words", SENTENCES, ids=lambda words: " ".join(map(str, words)) or "plain")
def test_the_report_says_what_the_device_traced_and_what_the_cpu_did(cli, square_obj, words, monkeypatch):
    def refuse(*args):
        raise OutOfDeviceMemory("full", 1, 0)

    if words == ("full",):
        monkeypatch.setattr(DeviceSurfaces, "__init__", refuse)
    options = () if words == ("full",) else words
    out = cli("render", square_obj, "--size", 8, "--device", "host", "--explain-plan", *options, "-o", "a.png").out
    assert f"The device host:0 {SENTENCES[words]}" in out


def test_a_study_on_a_device_has_the_numbers_of_the_cpu(cli, square_obj):
    matrix = "matrix", square_obj, "--sensors", "grid:0.5+0.5"
    assert cli(*matrix, "-o", "cpu.npy").code == cli(*matrix, "-o", "device.npy", "--device", "host").code == 0
    assert Path("cpu.npy").read_bytes() == Path("device.npy").read_bytes()


@pytest.mark.parametrize("device", ["host", "gpu"])
def test_a_device_against_the_plan_or_one_that_is_not_there_ends_with_2_and_no_file(cli, square_obj, device):
    for command in (["render", "-o", "a.png"], ["matrix", "-o", "a.npy"]):
        done = cli(command[0], square_obj, *command[1:], "--device", device, "--plan", "bsah+single")
        done.refused("does not trace on host:0" if device == "host" else "'gpu'")
    assert not Path("a.png").exists() and not Path("a.npy").exists()
