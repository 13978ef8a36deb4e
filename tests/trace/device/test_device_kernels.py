"""The list of the kernels of devices."""

import re
import shutil
import subprocess

import pytest

from antumbra.techniques.culling import device_culling  # noqa: F401, it adds kernels
from antumbra.trace.device.device_kernels import KERNELS
from antumbra.trace.device.device_launches import DeviceLaunches
from devices import opened

MOST_REGISTERS = {"trace_any": 64, "trace_samples": 72, "trace_nearest": 96, "trace_shafts": 96}
"""Of a thread, by ptxas: more would leave too few threads on a processor of a card to hide the latency of memory."""


def test_every_kernel_is_in_the_list_once():
    assert len({(each.kernel, each.key) for each in KERNELS.values()}) == len(KERNELS)


def test_launches_reuse_memory_that_is_large_enough():
    launches = DeviceLaunches(opened("host"))
    first = launches.block("a", 100, "a list")
    assert launches.block("a", 50, "a list") is first and launches.block("b", 50, "a list") is not first
    larger = launches.block("a", 200, "a list")
    assert larger is not first and larger.size >= 200


@pytest.mark.skipif(shutil.which("ptxas") is None, reason="ptxas is not installed, so registers are NOT checked")
@pytest.mark.parametrize("name", KERNELS)
def test_kernels_spill_no_registers(name, tmp_path):
    path = tmp_path / "kernel.ptx"
    path.write_bytes(KERNELS[name].code("ptx").code)
    command = ["ptxas", "-arch=sm_90", "-v", str(path), "-o", str(tmp_path / "kernel.cubin")]
    report = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    registers, spills = re.search(r"Used (\d+) registers", report), re.findall(r"(\d+) bytes spill", report)
    assert registers is not None and set(spills) == {"0"}, report
    assert int(registers[1]) <= MOST_REGISTERS.get(name, 255)
