"""A pool of processes that compile kernels, one per core.

Numba types and lowers in Python, under one lock per process, so threads would wait for each other. Each process takes
the next kernel when its previous one is done. The longest kernels go first, so that all processes finish at about the
same time. Finished kernels are on disk: Ctrl-C loses only the kernels in progress.

Each process reads one request per line and answers with null or an error message. A request is JSON: the kernel's name,
the kinds of its arguments, and the processor levels. Processes import Numba without scipy's linear algebra, which
starts faster. If the caller is killed, the system closes the pipe of requests, and the process ends at once, in the
middle of a kernel.
"""

import gc
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterable, Sequence
from queue import Empty, SimpleQueue
from typing import NamedTuple, TypeAlias

from ...base.progress import ProgressCallback
from ..marshalling import import_object
from ..parallel import thread_count
from ..processor import level
from .kernel_cache import KernelFolder, cache_folder

# --- Faster import of Numba -------------------------------------------------------------------------------------------


def import_numba() -> None:
    """Import Numba's array functions without scipy's linear algebra behind them, whose import takes 0.2 s.

    Use it only in compiling processes, since Numba then rejects np.dot in kernels. No kernel multiplies matrices.
    """
    if "scipy.linalg" in sys.modules or "numba.np.arraymath" in sys.modules:
        return
    sys.modules["scipy.linalg"] = None  # type: ignore[assignment]  # importing it now fails at once
    try:
        import numba.np.arraymath  # noqa: F401
    finally:
        del sys.modules["scipy.linalg"]


# --- The compiling process --------------------------------------------------------------------------------------------


def serve() -> None:
    """Serve `compile_kernels` until it closes the pipe. This process ignores Ctrl-C, since the caller ends it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    requests: SimpleQueue[str] = SimpleQueue()
    threading.Thread(target=_read_requests, args=(requests,), daemon=True).start()
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # other output must not be mistaken for an answer
    import_numba()
    gc.disable()  # also between kernels: the process is short, and nearly all that Numba creates lives as long
    from .device_code import FORMS, load_or_compile_forms
    from .kernel_cache import KernelFolder, cache_folder
    from .kernel_digest import kernel_digest
    from .kernel_loading import load_or_compile

    while True:
        name, key, levels = json.loads(requests.get())
        try:
            kernel = import_object(name)
            if levels == [*FORMS]:
                load_or_compile_forms(kernel, key)
            else:
                folders = [KernelFolder(cache_folder(), level) for level in levels]
                load_or_compile(kernel, key, kernel_digest(kernel, key), folders)
            message = None
        except Exception as error:
            message = f"{type(error).__name__}: {error}"
        answers.write(json.dumps(message) + "\n")
        answers.flush()


def _read_requests(requests: "SimpleQueue[str]") -> None:
    """Queue the caller's requests, and end this process as soon as the caller closes the pipe or is gone."""
    for line in sys.stdin:
        requests.put(line)
    os._exit(0)


# --- The pool ---------------------------------------------------------------------------------------------------------


_POLL_SECONDS = 0.1
_START = """
import json, sys
sys.path[:] = json.loads(sys.stdin.readline())
from antumbra.kernels.toolchain.compile_pool import serve
serve()
"""


class KernelRequest(NamedTuple):
    """A kernel to compile: its name, and the kinds of its arguments."""

    kernel: str  # module:qualname
    key: str  # kinds of the arguments, separated by spaces
    seconds: float = 0.0  # expected compile time


_Work: TypeAlias = "SimpleQueue[KernelRequest]"
_Done: TypeAlias = "SimpleQueue[tuple[KernelRequest | None, str | None] | None]"
"""Requests with error messages; None when a process has ended."""


class _CompileProcess(threading.Thread):
    """A compiling process, and the thread that sends it requests."""

    def __init__(self, levels: Sequence[str], work: _Work, done: _Done) -> None:
        super().__init__(daemon=True)
        self._levels, self._work, self._done = list(levels), work, done
        command, pipe = [sys.executable, "-c", _START], subprocess.PIPE
        environment = {**os.environ, "ANTUMBRA_CACHE": str(cache_folder())}
        self._process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, encoding="utf-8", env=environment)
        assert self._process.stdin is not None and self._process.stdout is not None
        self._requests, self._answers = self._process.stdin, self._process.stdout

    def run(self) -> None:
        try:
            self._send(sys.path)
            while True:
                request = self._work.get_nowait()
                self._send([request.kernel, request.key, self._levels])
                answer = self._answers.readline()
                self._done.put((request, json.loads(answer) if answer else "the compiling process ended"))
        except Empty:
            pass
        except (OSError, ValueError) as error:  # the process is gone
            self._done.put((None, str(error)))
        finally:
            self._done.put(None)

    def _send(self, message: object) -> None:
        self._requests.write(json.dumps(message) + "\n")
        self._requests.flush()

    def end(self) -> None:
        self._process.kill()
        self._process.wait()
        for pipe in (self._requests, self._answers):
            pipe.close()


def compile_kernels(
    requests: Iterable[KernelRequest],
    progress: ProgressCallback | None = None,
    processes: int | None = None,
    levels: Sequence[str] | None = None,
) -> list[str]:
    """Compile the kernels that are missing from the user's cache, and store them there.

    Parameters
    ----------
    requests : iterable of KernelRequest
    progress : function of (kernels done, kernels), optional
        Called in the calling thread.
    processes : int, optional
        None means one per core available to this process.
    levels : sequence of str, optional
        Processor levels, or destinations in libraries (`machine_code.Destination`). None: this processor's level.
        `device_code.FORMS`: the requests are for kernels of devices. Numba's part of the work is done once for all.

    Returns
    -------
    list of str
        Error messages, one per failed kernel. Calling such a kernel compiles it again, and raises.
    """
    ordered = sorted(set(requests), key=lambda each: -each.seconds)
    work: _Work = SimpleQueue()
    done: _Done = SimpleQueue()
    for each in ordered:
        work.put(each)
    workers = [
        _CompileProcess(levels or [level()], work, done)
        for _ in range(min(processes or thread_count(None), len(ordered)))
    ]
    try:
        for worker in workers:
            worker.start()
        return _wait(done, len(workers), len(ordered), progress)
    finally:
        for worker in workers:
            worker.end()
        KernelFolder(cache_folder(), level()).prune()


def _wait(done: _Done, n_running: int, total: int, progress: ProgressCallback | None) -> list[str]:
    n_done, errors = 0, []
    while n_running:
        if progress is not None:
            progress(n_done, total)
        try:
            answer = done.get(timeout=_POLL_SECONDS)  # a short wait, so that Ctrl-C is handled
        except Empty:
            continue
        if answer is None:
            n_running -= 1
            continue
        request, error = answer
        n_done += request is not None
        errors += [f"{request.kernel if request else 'a process'}: {error}"] if error else []
    if progress is not None:
        progress(n_done, total)
    return errors
