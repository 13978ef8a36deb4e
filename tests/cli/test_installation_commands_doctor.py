"""What ``antumbra doctor`` says, and the groups of options in help."""

import importlib.metadata
import json
from types import SimpleNamespace

import numpy as np
import pytest

import antumbra as at
from antumbra.devices import device_list
from antumbra.devices.device import DeviceError
from antumbra.devices.device_list import DeviceInfo
from antumbra.trace.device import self_test
from antumbra.trace.device.self_test import SelfTest


def test_an_installation_in_order(cli):
    told = cli("doctor", "--json").json()
    assert told["antumbra"] == at.__version__ and told["check"]["right"] is True
    assert told["kernels"]["compiled"] > 0 and told["kernels"]["writable"]
    assert "pvlib" in told["extras"]["sun"] and not {"docs", "test", "dev", "release"} & told["extras"].keys()


@pytest.fixture
def devices(monkeypatch):
    """A card that is right, one that is wrong, one that is in use, one that is too old; and no driver of OpenCL."""
    cards = [DeviceInfo(f"cuda:{k}", f"Card {k}", "CUDA 12.4", None, True) for k in range(3)]
    cards.append(DeviceInfo("cuda:3", "Card 3", "CUDA 12.4", "its compute capability is 6.1", True))
    cards.append(DeviceInfo("opencl", "", "", "no OpenCL driver was found", False))
    results = {"cuda:0": SelfTest(5000, 0), "cuda:1": SelfTest(5000, 7)}

    def run(name):
        if name not in results:
            raise DeviceError(f"{name}: CUDA_ERROR_DEVICE_UNAVAILABLE; another program has the card for itself")
        return results[name]

    monkeypatch.setattr(device_list, "list_devices", lambda: cards)
    monkeypatch.setattr(device_list, "open_device", lambda name: name)
    monkeypatch.setattr(self_test, "run_self_test", run)
    return results


def test_devices_are_listed_with_their_self_tests(cli, devices):
    told = cli("doctor", "--json")
    found = {device["name"]: device for device in json.loads(told.out)["devices"]}
    assert list(found) == ["cuda:0", "cuda:1", "cuda:2", "cuda:3", "opencl"] and told.code == 1
    assert (found["cuda:1"]["answers"], found["cuda:1"]["wrong"]) == (5000, 7)
    lines = " ".join(cli("doctor").out.split())
    assert "cuda:0 Card 0, CUDA 12.4: 5,000 answers are right" in lines
    assert "7 of 5,000 answers are WRONG: update the driver" in lines
    assert "cuda:2 Card 2, CUDA 12.4: cuda:2: CUDA_ERROR_DEVICE_UNAVAILABLE; another program" in lines
    assert "cuda:3 Card 3, CUDA 12.4: its compute capability is 6.1" in lines
    assert "opencl no OpenCL driver was found" in lines


def test_right_and_unusable_devices_are_no_failure(cli, devices):
    devices["cuda:1"] = SelfTest(5000, 0)
    assert cli("doctor").code == 0


def test_a_wrong_answer_is_reported(cli, monkeypatch, devices):
    monkeypatch.setattr(at, "visibility", lambda *_, **__: SimpleNamespace(seen=np.ones((1000, 2), bool)))
    monkeypatch.setattr(importlib.metadata, "requires", lambda _: ['not-installed>=1; extra == "bake"'])
    told = cli("doctor")
    assert told.code == 1 and "WRONG: please report this" in told.out
    assert "pip install 'antumbra[bake]' adds not-installed" in told.out
