"""Kernel libraries serve a package without Numba, llvmlite and a cache, as long as its sources are those of them."""

import json
import os
import platform
import shutil
import subprocess
import sys
import time
from importlib.util import find_spec

import pytest

import sample_package as sample
from antumbra.kernels.machine_code import SYSTEMS
from antumbra.kernels.processor import X86, level, usable
from antumbra.kernels.toolchain.kernel_library import LIST, LibraryList

if find_spec("ziglang") is None:
    pytest.skip("ziglang is not installed: kernel libraries NOT checked", allow_module_level=True)

NAMES = {"linux": "linux", "darwin": "macos", "win32": "windows"}
MACHINES = {"amd64": "x86_64", "arm64": "aarch64" if sys.platform == "linux" else "arm64"}
SYSTEM = f"{NAMES.get(sys.platform)}-{MACHINES.get(platform.machine().lower(), platform.machine().lower())}"
if SYSTEM not in SYSTEMS:
    pytest.skip(f"there are no libraries for {SYSTEM}: NOT checked", allow_module_level=True)

FEATURES = """
import json, sys
from antumbra.kernels import processor
print(json.dumps([processor.level(), "llvmlite" in sys.modules]))
"""
WITHOUT_COMPILER = """
from antumbra.kernels.toolchain import kernel_loading
kernel_loading.has_compiler = lambda: False
from antumbra.base.errors import InputError
from antumbra.sample import top
try:
    top.alone(1.5)  # a kind of argument that is not recorded
except InputError as error:
    print(error)
print(top.alone(1))
"""


def python(package, cache, program):
    """Run a program that imports a copy of the package; return what it prints."""
    env = sample.environment(package, cache)
    done = subprocess.run([sys.executable, "-c", program], env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """A copy of the package with a library of its sample kernels, for this level and a lower one."""
    folder = tmp_path_factory.mktemp("built")
    package = sample.write(folder)
    for file in package.rglob("needs.json"):
        file.unlink()
    record = """
import json
from antumbra.sample import top
top.results()
print(json.dumps([[event.kernel, event.key, {"seconds": 0}] for event in top.events]))
"""
    kernels = json.loads(python(package, folder / "cache", record))
    (package / "kernels" / "needs.json").write_text(json.dumps({"kernels": kernels, "jobs": {}}))
    levels = usable(level())[-2:]
    command = [sys.executable, "-m", "antumbra.kernels.toolchain.library_build", "--system", SYSTEM]
    command += [word for each in levels for word in ("--level", each)]
    env = sample.environment(package, folder / "cache")
    done = subprocess.run(command, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == len(levels)
    return package


@pytest.fixture
def package(built, tmp_path):
    """A copy with the same file times."""
    return shutil.copytree(built, tmp_path / "antumbra")


def test_a_library_serves_without_cache_and_compiler(package, tmp_path):
    results, sources, numba = sample.run(package, tmp_path / "cache")
    assert results["alone"] == 101 and set(sources.values()) == {"library"} and not numba
    assert not (tmp_path / "cache").exists()


def test_all_levels_give_the_same_results(package, tmp_path, monkeypatch):
    expected = sample.run(package, tmp_path / "cache")[0]
    for each in usable(level())[-2:]:
        monkeypatch.setenv("ANTUMBRA_LEVEL", each)
        results, sources, _ = sample.run(package, tmp_path / "cache")
        assert results == expected and set(sources.values()) == {"library"}


@pytest.mark.skipif(level() not in X86, reason="only x86 has several levels")
def test_any_library_tells_the_level_without_llvm(package, tmp_path):
    paths = sorted((package / "kernels" / "libraries").glob("libantumbra-*"))
    assert len(paths) == len(usable(level())[-2:])
    for path in paths[:-1]:
        path.unlink()
    assert json.loads(python(package, tmp_path / "cache", FEATURES)) == [level(), False]


def touch_later(file):
    later = time.time() + 3600
    os.utime(file, (later, later))


def test_an_edited_kernel_is_compiled(package, tmp_path):
    sample.edit(package, "sample/top.py", "return x + 100", "return x + 200")
    touch_later(package / "sample" / "top.py")
    results, sources, _ = sample.run(package, tmp_path / "cache")
    assert results["alone"] == 201 and sources["alone"] == "compiled"


def test_a_file_that_was_written_again_unchanged_counts(package, tmp_path):
    touch_later(package / "sample" / "top.py")
    assert set(sample.run(package, tmp_path / "cache")[1].values()) == {"library"}


def test_only_files_with_kernels_count(package):
    files = LibraryList.read(package / "kernels" / "libraries").files
    assert {"sample/top.py", "sample/parts.py", "sample/guest.py", "kernels/simd/lanes.py"} <= set(files)
    assert not {"cli/app.py", "kernels/toolchain/compiling.py"} & set(files)


@pytest.mark.parametrize("damage", [b"", b"{}", b"[1]", b"\x7fELF"])
@pytest.mark.parametrize("what", ["list", "library"])
def test_damaged_files_do_not_count(package, tmp_path, what, damage):
    libraries = package / "kernels" / "libraries"
    for file in libraries.iterdir():
        if (file.name == LIST) == (what == "list"):
            times = file.stat()
            file.write_bytes(damage)
            os.utime(file, (times.st_atime, times.st_mtime))
    results, sources, _ = sample.run(package, tmp_path / "cache")
    assert results["alone"] == 101 and "library" not in sources.values()


def test_a_missing_kernel_without_a_compiler(package, tmp_path):
    message, result = python(package, tmp_path / "cache", WITHOUT_COMPILER).splitlines()
    assert result == "101"
    assert message.startswith("antumbra.sample.top:alone is not among") and "pip install 'antumbra[jit]'" in message
