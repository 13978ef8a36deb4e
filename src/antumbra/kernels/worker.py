"""A process that compiles: it reads what is wanted, a line each, and answers with null or with what went wrong.

A line is the kernel's name, the kinds of its arguments, and the levels of processors, as JSON.
"""

import json
import os
import signal
import sys

from .arguments import named
from .numba_import import import_numba


def main() -> None:
    """Serve `crew.compile_all` until it closes the pipe. Ctrl-C is the caller's: it ends this process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # what else is printed must not be taken for an answer
    import_numba()
    from .cache import Folder, cache_folder
    from .closure import kernel_digest
    from .loading import kept_or_made

    for line in sys.stdin:
        name, key, levels = json.loads(line)
        try:
            kernel, folders = named(name), [Folder(cache_folder(), level) for level in levels]
            kept_or_made(kernel, key, kernel_digest(kernel, key), folders)
            problem = None
        except Exception as error:
            problem = f"{type(error).__name__}: {error}"
        answers.write(json.dumps(problem) + "\n")
        answers.flush()
