"""Machine code on disk: damage is found, processes share the work, old files are removed."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from hashlib import blake2b
from pathlib import Path

import pytest

import sample_package as sample
from antumbra.kernels.toolchain import kernel_cache
from antumbra.kernels.toolchain.kernel_cache import KernelCode, from_record

CODE = KernelCode("module:kernel", "i A[f4,1,C]", ["module:Pair", ["i", "n"]], b"machine code " * 50)
CREW = """
import json, sys
from antumbra.kernels.toolchain.compile_pool import KernelRequest, compile_kernels

kernels = [KernelRequest(f"antumbra.sample.top:{name}", key) for name, key in json.loads(sys.argv[1])]
calls = []
wrong = compile_kernels(kernels, lambda done, total: calls.append((done, total)), processes=int(sys.argv[2]))
print(json.dumps([wrong, calls[0], calls[-1]]))
"""
GOOD = [("alone", "i"), ("by_call", "i"), ("by_constant", "i"), ("by_overload", "i"), ("by_intrinsic", "A[f4,1,C]")]


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    return sample.write(tmp_path_factory.mktemp("package"))


@pytest.fixture(scope="module")
def filled(package, tmp_path_factory):
    """A cache that two processes filled at the same time, and the sources of their code."""
    folder = tmp_path_factory.mktemp("shared") / "cache"
    command = [sys.executable, "-c", sample.RUN]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    both = [subprocess.Popen(command, env=sample.environment(package, folder), **pipes) for _ in range(2)]
    outputs = [process.communicate() for process in both]
    assert not any(process.returncode for process in both), outputs
    return folder, [dict(json.loads(out)[1]) for out, _ in outputs]


@pytest.fixture
def copied(filled, tmp_path):
    return Path(shutil.copytree(filled[0], tmp_path / "cache"))


def kernels_in(folder):
    return sorted(folder.rglob("*.kernel"))


# --- records -----------------------------------------------------------------------------------------------------


def test_a_record_comes_back():
    assert from_record(CODE.record()) == CODE


@pytest.mark.parametrize("end", [0, 5, 17, 30, 60, -1])
def test_a_truncated_record_is_nothing(end):
    assert from_record(CODE.record()[:end]) is None


def test_a_record_with_any_byte_changed_is_nothing():
    record = CODE.record()
    for i in range(len(record)):
        assert from_record(record[:i] + bytes([record[i] ^ 4]) + record[i + 1 :]) is None


# --- the user's folder -------------------------------------------------------------------------------------------


def test_two_processes_do_the_work_once(filled):
    folder, (one, other) = filled
    assert one.keys() == other.keys() and len(one) == len(kernels_in(folder))
    assert all({one[name], other[name]} == {"compiled", "cache"} for name in one)
    assert not list(folder.rglob("*.lock")) and not list(folder.rglob("*.part"))


DAMAGES = {
    "empty": lambda whole: b"",
    "cut": lambda whole: whole[: len(whole) // 2],
    "header only": lambda whole: b"antumbra kernel 1\n",
    "foreign": lambda whole: b"\x7fELF foreign",
}


def test_damaged_files_are_made_anew(package, copied):
    files = kernels_in(copied)
    whole = [file.read_bytes() for file in files]
    for file, damage in zip(files, DAMAGES.values(), strict=False):
        file.write_bytes(damage(file.read_bytes()))
    results, sources, _ = sample.run(package, copied)
    untouched = len(files) - len(DAMAGES)
    assert untouched > 0 and sorted(sources.values()) == ["cache"] * untouched + ["compiled"] * len(DAMAGES)
    assert results["alone"] == 101 and [file.read_bytes() for file in files] == whole


def swapped(file, other):
    """The bytes of another kernel, with a valid checksum."""
    file.write_bytes(other.read_bytes())


def other_json(file, other):
    body = (9).to_bytes(4, "little") + b'{"a": [1]' + b"not zlib"
    file.write_bytes(kernel_cache._MAGIC + blake2b(body, digest_size=kernel_cache._SUM).digest() + body)


def pipe(file, other):
    file.unlink()
    os.mkfifo(file)


def link(file, other):
    file.unlink()
    file.symlink_to(other)


def folder(file, other):
    file.unlink()
    file.mkdir()


@pytest.mark.skipif(os.name != "posix", reason="pipes and links")
@pytest.mark.parametrize("put", [swapped, other_json, pipe, link, folder])
def test_what_stands_in_place_of_a_kernel_is_replaced(package, copied, put):
    files = kernels_in(copied)
    file = next(each for each in files if from_record(each.read_bytes()).kernel.endswith(":alone"))
    other = next(each for each in files if from_record(each.read_bytes()).kernel.endswith(":by_call"))
    put(file, other)
    results, sources, _ = sample.run(package, copied)
    assert results["alone"] == 101 and results["by_call"] == 4 and sources["alone"] == "compiled"
    assert sorted(sources.values()).count("compiled") == 1
    if put is not folder:  # is not removed: it may hold something of the user's
        assert from_record(file.read_bytes()).kernel.endswith(":alone") and not file.is_symlink()


def test_a_folder_that_cannot_be_written_is_told_once(package, tmp_path):
    (tmp_path / "file").write_text("")
    env = sample.environment(package, tmp_path / "file")
    done = subprocess.run([sys.executable, "-c", sample.RUN], env=env, capture_output=True, text=True)
    assert done.returncode == 0 and json.loads(done.stdout)[0]["alone"] == 101
    (line,) = done.stderr.splitlines()
    assert "cannot be written" in line and "kernels are compiled each time" in line


def test_pruning_removes_what_nobody_uses(tmp_path):
    folder = kernel_cache.KernelFolder(tmp_path, "some-level")
    codes = {name: CODE._replace(machine=kernel_cache.symbol_of(name).encode()) for name in ("old", "new", "used")}
    for digest, code in codes.items():
        folder.put(digest, code)
    long_ago = time.time() - (kernel_cache.UNUSED_DAYS + 1) * 86400
    for digest in "old", "used":
        os.utime(folder.path / f"{digest}.kernel", (long_ago, long_ago))
    other = tmp_path / "kernels" / "an-older-toolchain" / "some-level" / "x.kernel"
    other.parent.mkdir(parents=True)
    other.write_text("")
    os.utime(other, (long_ago, long_ago))
    (tmp_path / "0123456789abcdef" / "compiled").mkdir(parents=True)  # of version 0.1
    (tmp_path / "mine").mkdir()
    assert folder.get("used") == codes["used"]
    folder.prune()
    assert {file.stem for file in kernels_in(tmp_path)} == {"new", "used"}
    assert {path.name for path in tmp_path.iterdir()} == {"kernels", "mine"}
    assert [path.name for path in (tmp_path / "kernels").iterdir()] == [kernel_cache.toolchain()]


# --- several processes -------------------------------------------------------------------------------------------


def compile_by_crew(package, folder, kernels):
    env = sample.environment(package, folder)
    command = [sys.executable, "-c", CREW, json.dumps(kernels), "2"]
    done = subprocess.run(command, env=env, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_a_crew_compiles_and_tells_what_went_wrong(package, tmp_path):
    bad = [("by_field", "i"), ("missing", "i")]
    wrong, first, last = compile_by_crew(package, tmp_path / "cache", GOOD + bad)
    assert first == [0, 7] and last == [7, 7] and len(kernels_in(tmp_path / "cache")) == len(GOOD)
    assert sorted(line.split(": ")[0].rpartition(":")[2] for line in wrong) == ["by_field", "missing"]
    _, sources, _ = sample.run(package, tmp_path / "cache")
    assert {name for name, source in sources.items() if source == "cache"} == {name for name, _ in GOOD}


@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
def test_ctrl_c_leaves_a_usable_cache_and_no_process(package, tmp_path):
    folder = tmp_path / "cache"
    env = sample.environment(package, folder)
    waits = CREW + "import time; time.sleep(600)"  # on a busy machine all kernels may be done before the signal
    process = subprocess.Popen(
        [sys.executable, "-c", waits, json.dumps(GOOD), "1"],  # one process: most kernels are left after the first
        env=env,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    deadline = time.monotonic() + 60
    while not kernels_in(folder) and time.monotonic() < deadline:
        time.sleep(0.01)
    os.killpg(process.pid, signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode != 0 and "KeyboardInterrupt" in errors
    with pytest.raises(ProcessLookupError):
        for _ in range(600):  # the processes that it started have ended, or are about to end
            os.killpg(process.pid, 0)
            time.sleep(0.1)
    assert kernels_in(folder) and not list(folder.rglob("*.lock"))[len(GOOD) :]
    assert sample.run(package, folder)[0]["alone"] == 101


ENDLESS = """
import sys
from antumbra.kernels.toolchain import kernel_loading
from antumbra.kernels.toolchain.compile_pool import serve

def compile_forever(*request):
    print("compiling", file=sys.stderr, flush=True)
    while True:
        pass

kernel_loading.load_or_compile = compile_forever
serve()
"""


def test_a_compiling_process_ends_in_the_middle_of_a_kernel_when_its_caller_is_gone(package, tmp_path):
    env, pipe = sample.environment(package, tmp_path), subprocess.PIPE
    process = subprocess.Popen(
        [sys.executable, "-c", ENDLESS], env=env, stdin=pipe, stdout=pipe, stderr=pipe, text=True, cwd=package.parent
    )
    process.stdin.write('["antumbra.sample.top:alone", "i", ["x86-64-v2"]]\n')
    process.stdin.flush()
    assert process.stderr.readline() == "compiling\n"
    process.stdin.close()  # as the system does when a process is killed
    assert process.wait(timeout=120) == 0


@pytest.mark.skipif(os.name != "posix", reason="sends a signal")
def test_four_processes_fill_one_cache_though_one_is_killed(package, tmp_path):
    folder = tmp_path / "cache"
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    command, env = [sys.executable, "-c", sample.RUN], sample.environment(package, folder)
    killed, *others = [subprocess.Popen(command, env=env, cwd=package.parent, **pipes) for _ in range(4)]
    while not list(folder.rglob("*.lock")) and killed.poll() is None:  # until somebody compiles
        time.sleep(0.01)
    killed.kill()
    outputs = [process.communicate() for process in others]
    killed.communicate()
    assert not any(process.returncode for process in others), outputs
    found = [json.loads(out) for out, _ in outputs]
    assert all(results == found[0][0] for results, *_ in found) and found[0][0]["alone"] == 101
    assert set(sample.run(package, folder)[1].values()) == {"cache"}
