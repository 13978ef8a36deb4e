"""OpenCL's drivers: which devices are usable, why others are not, and how the driver in Intel's wheels is found."""

import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from antumbra.base.extras import MissingPackage
from antumbra.devices import opencl_drivers
from antumbra.devices.device import DeviceError
from antumbra.devices.opencl import OpenCl
from antumbra.devices.opencl_drivers import NO_DRIVER, OpenClDevice, opencl_devices

pyopencl = pytest.importorskip("pyopencl", reason="pyopencl is not installed: OpenCL's drivers are NOT checked")
FP, SVM = pyopencl.device_fp_config, pyopencl.device_svm_capabilities


class Handle(SimpleNamespace):
    """A pyopencl.Device that can run our kernels, but for what a test changes."""

    def __init__(self, **changes):
        properties = {
            "name": " Arc A770 ",
            "vendor": "Intel",
            "type": pyopencl.device_type.GPU,
            "platform": SimpleNamespace(name="Intel Graphics"),
            "driver_version": "25.1",
            "address_bits": 64,
            "single_fp_config": FP.DENORM | FP.ROUND_TO_NEAREST | FP.INF_NAN,
            "DOUBLE_FP_CONFIG": FP.DENORM,
            "IL_VERSION": "SPIR-V_1.0 SPIR-V_1.4",
            "SVM_CAPABILITIES": SVM.COARSE_GRAIN_BUFFER,
        }
        super().__init__(**properties | changes)

    def get_info(self, which):
        names = {getattr(pyopencl.device_info, name): name for name in vars(self) if name.isupper()}
        if isinstance(value := getattr(self, names[which]), Exception):
            raise value
        return value


def test_a_usable_card_is_described():
    found = OpenClDevice.of(Handle())
    assert found[1:] == ("Arc A770", "Intel Graphics 25.1", True, None)
    assert not OpenClDevice.of(Handle(type=pyopencl.device_type.CPU)).is_gpu


@pytest.mark.parametrize(
    "changes, problem",
    [
        ({"IL_VERSION": ""}, "its driver does not take SPIR-V; update it, or use another device"),
        ({"IL_VERSION": None}, "its driver does not take SPIR-V"),
        ({"IL_VERSION": "", "vendor": "NVIDIA Corporation"}, 'does not take SPIR-V; use device="cuda"'),
        ({"address_bits": 32}, "it has 32-bit addresses"),
        ({"DOUBLE_FP_CONFIG": 0}, "it has no float64"),
        ({"single_fp_config": FP.ROUND_TO_NEAREST}, "flushes small numbers to zero"),
        ({"single_fp_config": FP.DENORM}, "its float32 does not round to nearest"),
        ({"SVM_CAPABILITIES": 0}, "it has no shared virtual memory"),
    ],
)
def test_a_device_that_cannot_run_kernels_says_why(changes, problem, monkeypatch):
    device = OpenClDevice.of(Handle(**changes))
    assert problem in device.problem
    monkeypatch.setattr(opencl_drivers, "_devices", lambda: ([device], os.getpid()))
    with pytest.raises(DeviceError) as error:
        OpenCl()
    assert str(error.value) == f"opencl:0 (Arc A770): {device.problem}"


def test_an_old_driver_does_not_know_every_property():
    if not opencl_devices():
        pytest.skip("there is no OpenCL driver: its errors are NOT checked")
    with pytest.raises(pyopencl.Error) as error:
        pyopencl.SVMAllocation(pyopencl.Context([opencl_devices()[0].handle]), 1, 3, 0)
    handle = Handle(IL_VERSION=error.value)
    assert OpenClDevice.of(handle).problem.startswith("its driver does not take SPIR-V")


def test_graphics_cards_come_first(monkeypatch):
    kinds = pyopencl.device_type
    platforms = [
        SimpleNamespace(get_devices=lambda: [Handle(name="CPU", type=kinds.CPU)]),
        SimpleNamespace(get_devices=lambda: [Handle(name="A"), Handle(name="B")]),
    ]
    monkeypatch.setattr(pyopencl, "get_platforms", lambda: platforms)
    monkeypatch.setattr(opencl_drivers, "_devices", opencl_drivers._devices.__wrapped__)
    assert [device.model for device in opencl_devices()] == ["A", "B", "CPU"]


def test_a_number_without_a_device_is_refused():
    count = len(opencl_devices())
    with pytest.raises(DeviceError, match=NO_DRIVER[:20] if count == 0 else f"there is no opencl:{count}; the last"):
        OpenCl(count)


def test_a_missing_package_is_named_with_its_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyopencl", None)
    monkeypatch.setattr(opencl_drivers, "_devices", opencl_drivers._devices.__wrapped__)
    with pytest.raises(MissingPackage, match=r"device=\"opencl\" needs pyopencl: pip install 'antumbra\[opencl\]'"):
        opencl_devices()


# The loader reads its settings once, so these run in processes of their own

_COUNT = "from antumbra.devices.opencl_drivers import opencl_devices; print(len(opencl_devices()))"
_OPEN = "from antumbra.devices.opencl import OpenCl; OpenCl()"


def in_process(code, **settings):
    cleaned = {
        name: value for name, value in os.environ.items() if name not in ("OCL_ICD_VENDORS", "OPENCL_VENDOR_PATH")
    }
    return subprocess.run([sys.executable, "-c", code], env=cleaned | settings, capture_output=True, text=True)


def test_a_machine_without_drivers_has_no_devices(tmp_path):
    done = in_process(_COUNT, OCL_ICD_VENDORS=str(tmp_path))
    assert done.stdout == "0\n", done.stderr
    assert f"DeviceError: {NO_DRIVER}" in in_process(_OPEN, OCL_ICD_VENDORS=str(tmp_path)).stderr


wheels = pytest.mark.skipif(
    opencl_drivers._wheel_library() is None, reason="Intel's driver for processors is NOT checked: it is not installed"
)


@wheels
def test_the_driver_in_intels_wheels_is_found_by_itself(tmp_path):
    done = in_process(_COUNT, OPENCL_VENDOR_PATH=str(tmp_path))
    assert done.stdout == "1\n", done.stderr


@wheels
def test_the_drivers_of_the_system_stay_listed(tmp_path, monkeypatch):
    library = opencl_drivers._wheel_library()
    (tmp_path / "card.icd").write_text("libsome_card.so\n")
    (tmp_path / "same.icd").write_text(f"/opt/somewhere/{library.name}\n")  # the same driver would be listed twice
    monkeypatch.setenv("OPENCL_VENDOR_PATH", str(tmp_path))
    monkeypatch.delenv("OCL_ICD_VENDORS", raising=False)
    with opencl_drivers._wheels_listed():
        folder = os.environ["OCL_ICD_VENDORS"]
        listed = {path.name: path.read_text() for path in Path(folder).glob("*.icd")}
    assert listed == {"card.icd": "libsome_card.so\n", "antumbra-intel-cpu.icd": f"{library}\n"}
    assert not os.path.exists(folder) and "OCL_ICD_VENDORS" not in os.environ


@wheels
def test_a_users_own_list_of_drivers_is_left_alone(tmp_path, monkeypatch):
    monkeypatch.setenv("OCL_ICD_VENDORS", str(tmp_path))
    with opencl_drivers._wheels_listed():
        assert os.environ["OCL_ICD_VENDORS"] == str(tmp_path)
