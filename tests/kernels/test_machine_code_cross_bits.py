"""The libraries of all levels give the same bits, and import nothing that computes."""

import json
import os
import platform
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

import sample_package as sample
from antumbra.kernels.machine_code import SYSTEMS
from antumbra.kernels.processor import X86, level, usable
from symbol_tables import ADHOC, imports_of, signature_flags

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_spec("ziglang") is None, reason="ziglang is not installed: libraries NOT checked"),
]
ROOT = Path(__file__).parents[2]
PROBE = ROOT / "tests" / "support" / "bits_probe.py"
MEMORY = {"memcpy", "memmove", "memset"}
LOADER = {
    "dyld_stub_binder",
    "__cxa_finalize",
    "__gmon_start__",
    "_ITM_deregisterTMCloneTable",
    "_ITM_registerTMCloneTable",
}
COMPUTE = {
    "acos",
    "atan",
    "atan2",
    "cos",
    "exp",
    "exp2",
    "fma",
    "fmaf",
    "fmod",
    "hypot",
    "log",
    "log1p",
    "log2",
    "pow",
    "sin",
    "sincos",
}
FEATURES = """
import numpy._core._multiarray_umath as umath
print(" ".join(umath.__cpu_dispatch__))
"""
HERE = usable(level())
linux_x86 = pytest.mark.skipif(
    not sys.platform.startswith("linux") or platform.machine() not in ("x86_64", "AMD64"),
    reason="not on x86-64 Linux: NOT checked",
)


def run(*command, **environment):
    done = subprocess.run(
        [sys.executable, *map(str, command)], env={**os.environ, **environment}, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """A copy of the package with the libraries of all levels that this machine runs."""
    folder = tmp_path_factory.mktemp("package")
    out = shutil.copytree(ROOT / "src" / "antumbra", folder / "antumbra", ignore=shutil.ignore_patterns("libraries"))
    levels = [f"--level={each}" for each in HERE]
    build = "-m", "antumbra.kernels.toolchain.library_build", "--system=linux-x86_64", *levels
    run(*build, "--out", out / "kernels" / "libraries", PYTHONPATH=str(folder))
    return folder


def digests(package, *arguments, **environment):
    lines = run(PROBE, *arguments, PYTHONPATH=str(package), **environment).splitlines()
    return dict(map(json.loads, lines))


@linux_x86
def test_libraries_import_only_memory_functions(package):
    paths = sorted((package / "antumbra" / "kernels" / "libraries").glob("*.so"))
    assert len(paths) == len(HERE)
    for path in paths:
        assert imports_of(path.read_bytes()) <= MEMORY


@linux_x86
def test_levels_threads_and_features_give_the_same_bits(package):
    expected = digests(package, ANTUMBRA_LEVEL=HERE[0])
    assert len(expected) > 90 and len(set(expected.values())) > 60
    frames = {value for name, value in expected.items() if name.startswith("frame ")}
    assert len(frames) == 1  # of all plans
    for each in HERE[1:]:
        assert digests(package, ANTUMBRA_LEVEL=each) == expected, each
    assert digests(package, "--threads", 3) == expected
    # NumPy without its vector code, and OpenBLAS for a processor without FMA
    features = run("-c", FEATURES).strip()
    plain = digests(package, NPY_DISABLE_CPU_FEATURES=features, OPENBLAS_CORETYPE="Nehalem")
    assert plain == expected
    not_run = [each for each in X86 if each not in HERE]
    if not_run:
        print(f"NOT run, because this processor lacks it: {', '.join(not_run)}")


RESULTS = """
import json, sys
from pathlib import Path
from antumbra.sample import top
if len(sys.argv) > 1:
    sys.path.append(sys.argv[1])
    from foreign_library import install
    install(Path(sys.argv[2]), Path(sys.argv[2]).parent)
print(json.dumps([top.results(), sorted({event.source for event in top.events})]))
"""


@pytest.fixture(scope="module")
def foreign(tmp_path_factory):
    """The libraries of a few sample kernels, for all systems."""
    folder = tmp_path_factory.mktemp("foreign")
    package = sample.write(folder)
    for file in package.rglob("needs.json"):
        file.unlink()
    env = sample.environment(package, folder / "cache")
    record = "import json\nfrom antumbra.sample import top\ntop.results()\n"
    record += 'print(json.dumps([[event.kernel, event.key, {"seconds": 0}] for event in top.events]))'
    kernels = json.loads(run("-c", record, **env))
    (package / "kernels" / "needs.json").write_text(json.dumps({"kernels": kernels, "jobs": {}}))
    systems = [f"--system={system}" for system in SYSTEMS]
    run("-m", "antumbra.kernels.toolchain.library_build", *systems, "--out", folder / "out", **env)
    return folder / "out"


@pytest.mark.parametrize("system", SYSTEMS)
def test_libraries_of_all_systems(foreign, system):
    paths = [path for path in (foreign / system).iterdir() if path.suffix in (".so", ".dylib", ".dll", ".wasm")]
    assert len(paths) == len(SYSTEMS[system].levels)
    if system == "wasm32":  # its imports: `tests/kernels/toolchain/test_library_build.py`
        return
    for path in paths:
        data = path.read_bytes()
        imports = imports_of(data)
        assert not imports & COMPUTE
        assert str(foreign.parent).encode() not in data and b"/tmp/" not in data
        if not system.startswith("windows"):  # these initialise Microsoft's C library
            assert imports <= MEMORY | LOADER
        if system == "macos-arm64":  # Apple silicon refuses unsigned code
            assert signature_flags(data) & ADHOC


@linux_x86
@pytest.mark.skipif(find_spec("lief") is None, reason="lief is not installed: images of libraries NOT run")
@pytest.mark.parametrize("each", HERE)
@pytest.mark.parametrize("system", ["macos-x86_64", "windows-x86_64"])
def test_kernels_run_in_images_of_foreign_libraries(foreign, system, each):
    (library,) = (foreign / system).glob(f"*{each}.d*")
    image = library.with_suffix(".npz")
    run(ROOT / "scripts" / "library_images.py", library, image)
    env = sample.environment(foreign.parent / "antumbra", foreign.parent / "cache")
    native, _ = json.loads(run("-c", RESULTS, **env))
    found, sources = json.loads(run("-c", RESULTS, ROOT / "tests" / "support", image, **env))
    assert found == native and len(found) >= 12
    assert sources == ["library"]
