"""Linking kernels into libraries."""

import pytest

from antumbra.kernels.machine_code import library_destination
from antumbra.kernels.marshalling import import_object
from antumbra.kernels.toolchain.kernel_manifest import recorded_kernels
from antumbra.kernels.toolchain.library_build import WasmLinker

pytest.importorskip("ziglang")


def test_a_module_of_webassembly_needs_nothing_but_memory(tmp_path):
    wasmtime = pytest.importorskip("wasmtime")
    from antumbra.kernels.toolchain.compiling import compile_kernel
    from antumbra.kernels.toolchain.kernel_cache import symbol_of

    request = next(each for each in recorded_kernels().kernels if each.kernel.endswith("lbvh:_depth"))
    (code,) = compile_kernel(
        import_object(request.kernel), request.key, "some", [library_destination("wasm32", "simd128")]
    )
    (tmp_path / "kernel.o").write_bytes(code.machine)
    WasmLinker().link([tmp_path / "kernel.o"], [], [symbol_of("some")], tmp_path / "kernels.wasm")
    module = wasmtime.Module.from_file(wasmtime.Engine(), str(tmp_path / "kernels.wasm"))
    assert [(each.module, each.name) for each in module.imports] == [("env", "memory")]
    assert {each.name for each in module.exports} == {symbol_of("some"), "__stack_pointer", "__heap_base"}


def test_a_failed_link_names_the_library(tmp_path):
    with pytest.raises(RuntimeError, match=r"kernels\.wasm was not linked"):
        WasmLinker().link([], [], ["missing"], tmp_path / "kernels.wasm")
