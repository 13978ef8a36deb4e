"""Kernels of devices that are missing on disk are compiled in other processes, once."""

import device_kernels as sample
from antumbra.engine import precompilation
from antumbra.kernels.toolchain import compile_pool, device_code


def test_missing_kernels_of_devices_are_compiled_once(tmp_path, monkeypatch):
    for module in device_code, compile_pool:
        monkeypatch.setattr(module, "cache_folder", lambda: tmp_path)
    kernels = [sample.FLOATS]
    assert not sample.FLOATS.is_on_disk()
    precompilation.precompile_devices(kernels)
    assert sample.FLOATS.is_on_disk()
    assert sorted(file.parent.name for file in tmp_path.rglob("*.kernel")) == ["ptx", "spirv"]
    monkeypatch.setattr(precompilation, "compile_kernels", None)
    precompilation.precompile_devices(kernels)
