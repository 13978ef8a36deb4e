"""The list of the kernels of devices."""

import re
import shutil
import subprocess

import pytest

from antumbra.techniques.culling.device_culling import CULL_KERNELS
from antumbra.techniques.culling.device_sources import SOURCE_KERNELS
from antumbra.trace.device.build_kernels import BUILD_KERNELS
from antumbra.trace.device.cutout_kernels import CUTOUT_KERNELS
from antumbra.trace.device.device_kernels import KERNELS, add_kernels
from antumbra.trace.device.device_launches import DeviceLaunches
from antumbra.trace.device.instance_kernels import INSTANCE_KERNELS
from antumbra.trace.device.nearest_list_kernels import NEAREST_LIST_KERNELS
from antumbra.trace.device.pixel_kernels import PIXEL_KERNELS
from antumbra.trace.device.ploc_kernels import PLOC_KERNELS
from antumbra.trace.device.raster_kernels import RASTER_KERNELS
from antumbra.trace.device.tree_list_kernels import TREE_LIST_KERNELS
from devices import opened

MOST_REGISTERS = {"trace_any": 64, "trace_samples": 72, "trace_nearest": 96, "trace_shafts": 96, "trace_listed": 80}
"""Of a thread, by ptxas: more would leave too few threads on a processor of a card to hide the latency of memory."""


def test_every_kernel_is_in_the_list_once():
    assert len({(each.kernel, each.key) for each in KERNELS.values()}) == len(KERNELS)


@pytest.mark.parametrize(
    "kernels",
    [
        BUILD_KERNELS,
        PLOC_KERNELS,
        CUTOUT_KERNELS,
        INSTANCE_KERNELS,
        TREE_LIST_KERNELS,
        CULL_KERNELS,
        SOURCE_KERNELS,
        PIXEL_KERNELS,
        RASTER_KERNELS,
        NEAREST_LIST_KERNELS,
    ],
)
def test_no_kernel_takes_the_name_of_another_one(kernels):
    assert kernels.items() <= KERNELS.items()
    name = min(kernels)
    with pytest.raises(ValueError, match=f"^other kernels of devices are named {name}$"):
        add_kernels({name: KERNELS["mark_rays"]})
    assert KERNELS[name] is kernels[name]


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
