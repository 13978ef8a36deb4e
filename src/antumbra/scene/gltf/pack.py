"""Binary glTF 2.0 files (GLB): a JSON chunk, and a chunk with the arrays."""

import json
import struct
from collections.abc import Sequence

import numpy as np

FLOAT, UNSIGNED_INT = 5126, 5125
"""`componentType` of float32 and uint32."""

ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963
"""`target` of a buffer view with vertices, and with indices."""


_UPRIGHT = [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]  # by columns


def upright(up: str) -> dict:
    """The transform of a node that turns the up axis of a scene, "y" or "z", to +Y, as glTF has it.

    It is a matrix and no quaternion, because square roots of 1/2 would round the coordinates.
    """
    return {"matrix": _UPRIGHT} if up == "z" else {}


def views_of(blocks: Sequence[np.ndarray], targets: Sequence[int]) -> dict:
    """The keys `bufferViews` and `buffers` of a file whose arrays follow each other."""
    starts = np.cumsum([0, *(block.nbytes for block in blocks)]).tolist()
    views = [
        {"buffer": 0, "byteOffset": a, "byteLength": z - a, "target": t} for a, z, t in zip(starts, starts[1:], targets)
    ]
    return {"bufferViews": views, "buffers": [{"byteLength": starts[-1]}]}


def packed(root: dict, blocks: Sequence[np.ndarray]) -> bytes:
    """The bytes of a file: its JSON, and arrays whose sizes are multiples of four bytes."""
    return assembled(json.dumps(root, allow_nan=False).encode(), b"".join(block.tobytes() for block in blocks))


def assembled(text: bytes, binary: bytes) -> bytes:
    """The bytes of a file: its JSON as text, and the bytes of its arrays."""
    chunks = [(b"JSON", text + b" " * (-len(text) % 4)), (b"BIN\0", binary + bytes(-len(binary) % 4))]
    body = b"".join(struct.pack("<I4s", len(data), kind) + data for kind, data in chunks)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body
