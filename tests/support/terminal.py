"""A terminal in place of standard error."""

import io
import threading


class Terminal(io.StringIO):
    """Text written to a terminal. The event `written` is set by the first write."""

    def __init__(self):
        super().__init__()
        self.written = threading.Event()

    def isatty(self):
        return True

    def write(self, text):
        self.written.set()
        return super().write(text)
