"""A process that compiles: it reads what is wanted, a line each, and answers with null or with what went wrong."""

import gc
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
    gc.disable()  # Numba makes many objects that live on; looking through them is a seventh of all time
    from . import loading

    for line in sys.stdin:
        name, key = json.loads(line)
        try:
            loading.ensure(named(name), key)
            problem = None
        except Exception as error:
            problem = f"{type(error).__name__}: {error}"
        answers.write(json.dumps(problem) + "\n")
        answers.flush()
