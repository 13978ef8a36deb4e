"""Names of devices, the list of them, and which one plans may choose."""

import pytest

from antumbra.base.errors import InputError
from antumbra.devices import device_list
from antumbra.devices.device import DeviceError
from antumbra.devices.device_list import (
    VARIABLE,
    DeviceInfo,
    best_card,
    default_device,
    list_devices,
    open_device,
    parse_device,
)


def kinds(monkeypatch, **listed):
    """Let there be only these devices: kind -> its devices, or an error."""

    def listing(found):
        if isinstance(found, Exception):
            raise found
        return found

    made = {kind: device_list._Kind(lambda found=found: listing(found), None) for kind, found in listed.items()}
    monkeypatch.setattr(device_list, "_KINDS", made)


CARD = DeviceInfo("cuda:0", "H100", "CUDA 12.4", None, True)
OLD = DeviceInfo("cuda:1", "GTX 1080", "CUDA 12.4", "its compute capability is 6.1", True)
ARC = DeviceInfo("opencl:0", "Arc", "Intel 25", None, True)
PROCESSOR = DeviceInfo("opencl:1", "Xeon", "Intel 25", None, False)
MISSING = DeviceError("CUDA: there is no NVIDIA driver")


@pytest.mark.parametrize(
    "name, kind, number",
    [("cpu", "cpu", 0), ("cuda", "cuda", 0), ("cuda:12", "cuda", 12), ("opencl:1", "opencl", 1), ("host", "host", 0)],
)
def test_names_have_a_kind_and_a_number(name, kind, number):
    assert parse_device(name) == (kind, number)


@pytest.mark.parametrize("name", ["gpu", "cuda:", "cuda:-1", "cuda:1000", "cpu:0", "CUDA", "cuda:0 ", "", None, 0])
def test_other_names_list_the_valid_ones(name, monkeypatch):
    kinds(monkeypatch, cuda=[CARD, OLD], opencl=[ARC, PROCESSOR], host=[])
    with pytest.raises(InputError) as error:
        parse_device(name, "--device")
    assert str(error.value).startswith("--device is ")
    assert str(error.value).endswith("it must be cpu, cuda:0, opencl:0, opencl:1 or host")


def test_kinds_that_cannot_be_used_are_named(monkeypatch):
    kinds(monkeypatch, cuda=MISSING, opencl=[PROCESSOR], host=[])
    with pytest.raises(InputError, match=r"cpu, opencl:1 or host; cuda cannot be used here, antumbra doctor says why$"):
        parse_device("gpu")


def test_the_list_has_every_device_and_why_a_kind_has_none(monkeypatch):
    kinds(monkeypatch, cuda=MISSING, opencl=[ARC, PROCESSOR])
    assert list_devices() == [DeviceInfo("cuda", "", "", str(MISSING), False), ARC, PROCESSOR]


@pytest.mark.parametrize(
    "listed, expected",
    [
        ({"cuda": [CARD], "opencl": [ARC]}, "cuda:0"),
        ({"cuda": [OLD], "opencl": [ARC]}, "opencl:0"),
        ({"cuda": [OLD, CARD._replace(name="cuda:2")], "opencl": []}, "cuda:2"),
        ({"cuda": MISSING, "opencl": [ARC, PROCESSOR]}, "opencl:0"),
        ({"cuda": MISSING, "opencl": [PROCESSOR]}, None),  # a processor is never chosen by itself
        ({"cuda": MISSING, "opencl": MISSING}, None),
    ],
)
def test_the_best_card_is_a_card_that_can_be_used(listed, expected, monkeypatch):
    kinds(monkeypatch, **listed)
    assert best_card() == expected


def test_no_processor_of_this_machine_is_chosen():
    assert best_card() not in [device.name for device in list_devices() if not device.is_card]


def test_the_variable_names_the_device(monkeypatch):
    for value, expected in [("opencl:1", "opencl:1"), ("cpu", "cpu"), ("", None)]:
        monkeypatch.setenv(VARIABLE, value)
        assert default_device() == expected
    monkeypatch.setenv(VARIABLE, "gpu")
    with pytest.raises(InputError, match=r"^ANTUMBRA_DEVICE is 'gpu'; "):
        default_device()
    monkeypatch.delenv(VARIABLE)
    assert default_device() is None


def test_an_open_device_stays_as_it_is():
    device = open_device("host")
    assert open_device(device) is device


def test_the_processors_threads_are_no_device():
    with pytest.raises(InputError, match='device is "cpu", and this needs a card'):
        open_device("cpu")


def test_there_is_one_host():
    assert open_device("host:0").name == "host:0"
    with pytest.raises(InputError, match="there is no host:1"):
        open_device("host:1")
