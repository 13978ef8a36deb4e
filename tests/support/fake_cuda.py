"""NVIDIA's driver for tests without a card: `fake_cuda.c` compiled, and put into the place of the real one."""

import ctypes
import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import pytest

from antumbra.devices import cuda, cuda_driver

_SOURCE = Path(__file__).with_suffix(".c")
_KERNEL = ctypes.CFUNCTYPE(None, ctypes.POINTER(ctypes.c_int64), ctypes.c_int64, ctypes.c_int64)


class Code(NamedTuple):
    """Device code as far as drivers look at it."""

    form: str
    entry: str
    words: int
    code: bytes
    digest: str


class Counts(NamedTuple):
    """What the driver has made and not freed; contexts that this thread has pushed and not popped."""

    memory: int
    streams: int
    events: int
    pinned: int
    contexts: int


class FakeCuda:
    """The library, and its settings."""

    def __init__(self, path: str) -> None:
        self.path, self._library, self._kept = path, ctypes.CDLL(path), []

    def use(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Put it into the place of the real driver for a test."""
        self._library.fake_reset()
        monkeypatch.setattr(cuda_driver, "LIBRARY", self.path)
        self.restart()

    def restart(self) -> None:
        """What a new process starts with: no driver loaded, no card opened."""
        cuda_driver._driver.cache_clear()
        cuda._cards.clear()

    def fail(self, function: str, status: int) -> None:
        """Let a function return an error from now on."""
        self._library.fake_fail(function.encode(), status)

    def machine(self, cards: int = 1, version: int = 12040, capability: int = 90, mode: int = 0) -> None:
        """Which cards there are, and what the driver supports."""
        self._library.fake_set(cards, version, capability, mode)

    def keep_busy(self, queries: int) -> None:
        """Let events be pending for so many queries; -1: forever."""
        self._library.fake_pend(queries)

    def register(self, code, run) -> None:
        """Let ``run(words, blocks, block)`` be the kernel of a name."""
        self._kept.append(_KERNEL(lambda words, blocks, block: run(words[: code.words], blocks, block)))
        self._library.fake_register(code.entry.encode(), self._kept[-1], code.words)

    def counts(self) -> Counts:
        numbers = (ctypes.c_int * 5)()
        self._library.fake_counts(numbers)
        return Counts(*numbers)


def built(folder: Path, source: Path = _SOURCE) -> str:
    """The path of a shared library compiled from a C file; skips the test if there is no compiler."""
    out = folder / f"{source.stem}.{'dll' if sys.platform == 'win32' else 'so'}"
    if shutil.which("cc"):
        compiler = ["cc"]
    elif find_spec("ziglang"):
        compiler = [sys.executable, "-m", "ziglang", "cc"]
    else:
        pytest.skip("there is no C compiler: the CUDA driver is NOT checked")
    flags = [] if os.name == "nt" else ["-fPIC"]
    subprocess.run([*compiler, "-shared", *flags, "-O1", str(source), "-o", str(out)], check=True, capture_output=True)
    return str(out)


@pytest.fixture(scope="session")
def fake_cuda_library(tmp_path_factory):
    return built(tmp_path_factory.mktemp("cuda"))


@pytest.fixture
def fake_cuda(fake_cuda_library, monkeypatch):
    """A CUDA driver whose cards are the host."""
    driver = FakeCuda(fake_cuda_library)
    driver.use(monkeypatch)
    yield driver
    driver.restart()
