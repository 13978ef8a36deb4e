"""Machine code of one kernel for arguments of one kind, and its file format.

A record is ``magic, checksum, length of the description, description (JSON), object file (zlib)``. The checksum shows
that a record is truncated, changed or foreign. Such a record counts as missing.
"""

import json
import zlib
from hashlib import blake2b
from typing import NamedTuple

from .arguments import Spec

_MAGIC = b"antumbra kernel 1\n"
_SUM = 16
_HEAD = len(_MAGIC) + _SUM


class Code(NamedTuple):
    """Everything that a call from Python needs."""

    kernel: str  # module:qualname
    key: str  # kinds of the arguments, separated by blanks
    result: Spec  # kind of the result
    machine: bytes  # object file; the function's name holds the digest (`symbol_of`)

    def record(self) -> bytes:
        """The record's bytes."""
        about = json.dumps([self.kernel, self.key, self.result]).encode()
        body = len(about).to_bytes(4, "little") + about + zlib.compress(self.machine, 6)
        return _MAGIC + blake2b(body, digest_size=_SUM).digest() + body


def symbol_of(digest: str) -> str:
    """The function's name in the object file of a digest."""
    return f"antumbra_{digest}"


def from_record(data: bytes) -> Code | None:
    """The code in a file, or None if the file is damaged."""
    body = data[_HEAD:]
    if not data.startswith(_MAGIC) or blake2b(body, digest_size=_SUM).digest() != data[len(_MAGIC) : _HEAD]:
        return None
    end = 4 + int.from_bytes(body[:4], "little")
    kernel, key, result = json.loads(body[4:end])
    return Code(kernel, key, result, zlib.decompress(body[end:]))
