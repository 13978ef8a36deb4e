"""The exceptions raised for bad input, and for what is unavailable for now."""

import re

_ADDRESS = re.compile(r" at 0x[0-9a-fA-F]+")


class InputError(ValueError):
    """Raised for unusable input, with a one-line message that names the problem and its cure.

    The command line prints the message without a traceback and exits with code 2.
    """

    def __init__(self, message: str = "") -> None:
        super().__init__(one_line(message))


class UnavailableError(RuntimeError):
    """Raised if a cluster is unreachable or has no free cores, with a one-line message: the same call may work later.

    The command line prints the message without a traceback and exits with code 75, by which schedulers try again.
    """

    def __init__(self, message: str = "") -> None:
        super().__init__(one_line(message))


def one_line(text: str) -> str:
    """`text` on one line without control characters and memory addresses, since names in files may contain anything."""
    text = _ADDRESS.sub("", str(text))
    if not text.isprintable():
        text = "".join(c if c.isprintable() else " " if c.isspace() else "?" for c in text)
    return text.strip()
