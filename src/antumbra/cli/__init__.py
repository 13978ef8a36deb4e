"""The command ``antumbra``."""

import gc
import sys


def main(arguments: list[str] | None = None) -> int:
    """Run the command line on `arguments` (None: those of the process) and return the exit code.

    0: success. 1: an unexpected error. 2: input that cannot be used. 130: interrupted.
    """
    if arguments is None:
        arguments = sys.argv[1:]
        # Importing Numba and reading its cache makes a million objects that live as long as the process. Python's
        # garbage collector would traverse them again and again. This takes a sixth of the time of a small rendering.
        gc.set_threshold(200_000, 20, 20)
    try:
        from .app import run
        from .failures import guarded

        return guarded(run, arguments)
    except KeyboardInterrupt:  # during the imports
        print("antumbra: interrupted", file=sys.stderr)
        return 130
