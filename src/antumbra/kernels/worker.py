"""A compiling process: it reads one request a line, and answers each with null or with an error message.

A request is JSON: the kernel's name, the kinds of its arguments, and the levels of processors.
"""

import json
import os
import signal
import sys

from .arguments import named
from .numba_import import import_numba


def main() -> None:
    """Serve `crew.compile_all` until it closes the pipe. This process ignores Ctrl-C: the caller ends it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # other output must not be taken for an answer
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
