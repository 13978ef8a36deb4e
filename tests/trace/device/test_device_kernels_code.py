"""The device code of all kernels of devices: complete, exact, and recorded."""

import re

import pytest

from antumbra.devices.host.ptx_programs import PtxProgram
from antumbra.kernels.toolchain.device_code import FORMS
from antumbra.kernels.toolchain.kernel_manifest import package_manifest
from antumbra.kernels.toolchain.rounding_checks import check_rounding
from antumbra.techniques.culling import device_culling  # noqa: F401, it adds kernels
from antumbra.trace.device.device_kernels import KERNELS

NAMES = pytest.mark.parametrize("name", KERNELS)


@NAMES
@pytest.mark.parametrize("form", FORMS)
def test_all_float_operations_round_to_nearest(name, form):
    check_rounding(KERNELS[name].code(form))


def test_there_are_float_operations_in_kernels_of_devices():
    text = "".join(kernel.code("ptx").code.decode() for kernel in KERNELS.values())
    found = {kind: len(re.findall(rf"\t\w+\.rn\.{kind} ", text)) for kind in ("f32", "f64")}
    assert found["f32"] > 100 and found["f64"] > 100


@NAMES
def test_global_memory_is_never_read_through_generic_pointers(name):
    text = KERNELS[name].code("ptx").code.decode()
    assert ".global" in text and not re.search(r"\t(?:ld|st|atom)\.(?:v\d\.)?[bsuf]\d+ |cvta", text)


@NAMES
def test_the_host_device_knows_all_instructions(name):
    program = PtxProgram(KERNELS[name].code("ptx").code)
    assert program.entry == KERNELS[name].code("ptx").entry


def test_kernels_of_devices_are_recorded():
    """If this fails, run scripts/record_kernels.py."""
    recorded = {(each.kernel, each.key) for each in package_manifest().devices}
    assert recorded == {(each.kernel.name, each.key) for each in KERNELS.values()}
