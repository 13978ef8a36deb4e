"""The module of kernels of pages: from a wheel, from the cache, or linked."""

import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

import antumbra
from antumbra.base.errors import InputError
from antumbra.kernels.toolchain.kernel_library import MODULE
from antumbra.web import kernel_linking, kernel_module

needs_linker = pytest.mark.skipif(find_spec("ziglang") is None, reason="without ziglang, the module is NOT checked")
WITHOUT_TOOLS = """
import sys
sys.modules |= dict.fromkeys(["numba", "llvmlite", "ziglang"])  # as if they were not installed
from pathlib import Path
from antumbra.web.kernel_module import FOLDER, kernel_module
assert FOLDER.is_relative_to(sys.argv[1])
print(len(kernel_module().wasm))
"""


@needs_linker
def test_an_installed_module_needs_neither_compiler_nor_linker(tmp_path):
    package = tmp_path / "antumbra"
    made = shutil.ignore_patterns("__pycache__", "libraries", "papers")
    shutil.copytree(Path(antumbra.__file__).parent, package, ignore=made)
    kernel_linking.write_module(package / "web" / "kernels")
    command = [sys.executable, "-c", WITHOUT_TOOLS, str(tmp_path)]
    words = subprocess.run(command, env=os.environ | {"PYTHONPATH": str(tmp_path)}, check=True, capture_output=True)
    assert int(words.stdout) == (package / "web" / "kernels" / MODULE).stat().st_size


@needs_linker
def test_a_module_is_linked_once_and_a_damaged_one_again(tmp_path, monkeypatch):
    requests = kernel_linking.called_kernels()
    file, linked = tmp_path / "folder" / "kernels.module", []
    link = kernel_linking._link
    monkeypatch.setattr(kernel_linking, "_cached_file", lambda requests: file)
    monkeypatch.setattr(kernel_linking, "_link", lambda requests: linked.append(1) or link(requests))
    first = kernel_linking.linked_module()
    assert kernel_linking.linked_module() == first and linked == [1]
    assert len(first[1]) == len(requests) and first[0].startswith(b"\0asm")
    file.write_bytes(file.read_bytes()[:-1])
    assert kernel_linking.linked_module() == first and linked == [1, 1]


def test_modules_are_told_apart_by_their_kernels():
    requests = kernel_linking.called_kernels()
    assert kernel_linking._cached_file(requests) == kernel_linking._cached_file(requests)
    assert kernel_linking._cached_file(requests) != kernel_linking._cached_file(requests[1:])


@pytest.mark.parametrize("package, extra", [("numba", "jit"), ("ziglang", "build")])
def test_a_missing_tool_is_named_with_its_remedy(monkeypatch, package, extra):
    monkeypatch.setitem(sys.modules, "ziglang", sys)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(InputError, match=rf"first page .* needs {package}: pip install 'antumbra\[{extra}\]'"):
        kernel_module.kernel_module.__wrapped__()
