"""What ``antumbra doctor`` says, and the groups of options in help."""

import importlib.metadata
from types import SimpleNamespace

import numpy as np

import antumbra as at
from antumbra.cli.app import PANELS


def test_an_installation_in_order(cli):
    told = cli("doctor", "--json").json()
    assert told["antumbra"] == at.__version__ and told["check"]["right"] is True
    assert told["kernels"]["compiled"] > 0 and told["kernels"]["writable"]
    assert "pvlib" in told["extras"]["sun"] and not {"docs", "test", "dev", "release"} & told["extras"].keys()


def test_a_wrong_answer_is_reported(cli, monkeypatch):
    monkeypatch.setattr(at, "visibility", lambda *_, **__: SimpleNamespace(seen=np.ones((1000, 2), bool)))
    monkeypatch.setattr(importlib.metadata, "requires", lambda _: ['not-installed>=1; extra == "bake"'])
    told = cli("doctor")
    assert told.code == 1 and "WRONG: please report this" in told.out
    assert "pip install 'antumbra[bake]' adds not-installed" in told.out


def test_options_stand_in_groups(cli):
    told = cli("render", "--help").out
    places = [told.index(f"\n{title}:\n") for title in PANELS]
    assert places == sorted(places) and "\nOptions:\n" in told
    light = told[told.index("\nLight:\n") : told.index("\nQuality:\n")]
    assert "--vpl" in light and "--spp" not in light
    assert "\nLight:\n" not in cli("plans", "--help").out


def test_completion_names_commands(tmp_path):
    import os
    import subprocess
    import sys

    asks = {"_ANTUMBRA_COMPLETE": "complete_bash", "COMP_WORDS": "antumbra do", "COMP_CWORD": "1"}
    told = subprocess.run(
        [sys.executable, "-m", "antumbra"], env={**os.environ, **asks}, capture_output=True, text=True, cwd=tmp_path
    )
    assert told.stdout.split() == ["doctor"], told.stderr
