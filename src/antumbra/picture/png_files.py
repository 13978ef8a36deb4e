"""PNG files: rows are filtered and compressed in strips, several at a time.

Each strip is a piece of one deflate stream that ends on a byte boundary (a sync flush). Threads make the pieces in any
order, and concatenation joins them. The file does not depend on the number of threads.
"""

import struct
import zlib
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.parallel import map_in_threads

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_COLOUR_TYPES = {1: 0, 3: 2, 4: 6}  # channels -> grey, RGB, RGBA
_SUB, _UP = 1, 2  # filters: differences from the pixel to the left, and from the one above
STRIP_BYTES = 1 << 17  # enough that restarting the search for repetitions costs under 1 % of the file
FAST, SMALL = 1, 6  # levels of compression
_ADLER = 65521  # modulus of Adler-32


def png_file(
    pixels: NDArray[np.uint8] | NDArray[np.uint16],
    texts: dict[str, str] | None = None,
    *,
    is_srgb: bool = True,
    level: int = FAST,
    strip_bytes: int = STRIP_BYTES,
) -> bytes:
    """The contents of a PNG file.

    Parameters
    ----------
    pixels : (h, w) or (h, w, c) uint8 or uint16
        c = 1: grey, 3: red, green and blue, 4: also alpha.
    texts : dict, optional
        Keyword, in Latin-1 -> text in the metadata.
    is_srgb : bool
        Whether the file says that its colours are sRGB.
    level : int
        Effort of the compression, from 1 to 9.
    strip_bytes : int
        Bytes of the strips that threads compress; at least one row.
    """
    image = pixels[..., None] if pixels.ndim == 2 else pixels
    height, width, channels = image.shape
    rows = np.ascontiguousarray(image, image.dtype.newbyteorder(">")).reshape(height, width * channels).view(np.uint8)
    coder = _Coder(rows, channels * image.itemsize, level)
    step = max(1, strip_bytes // rows.shape[1])
    strips = map_in_threads(lambda y: coder.strip(y, min(y + step, height)), range(0, height, step))
    header = struct.pack(">2I5B", width, height, 8 * image.itemsize, _COLOUR_TYPES[channels], 0, 0, 0)
    chunks = [(b"IHDR", header)]
    chunks += [(b"sRGB", b"\0")] if is_srgb else []
    chunks += [(b"iTXt", name.encode("latin-1") + bytes(5) + text.encode()) for name, text in (texts or {}).items()]
    chunks += [(b"IDAT", _joined(strips, level)), (b"IEND", b"")]
    return _SIGNATURE + b"".join(_chunk(*chunk) for chunk in chunks)


# --- Strips of rows ---------------------------------------------------------------------------------------------------


class _PngRows(NamedTuple):
    """A compressed strip."""

    data: bytes  # of a raw deflate stream
    checksum: int  # Adler-32 of the filtered rows
    size: int  # bytes of the filtered rows


class _Coder(NamedTuple):
    """Filters and compresses strips of an image."""

    rows: NDArray[np.uint8]  # (h, b) uint8: the bytes of the file, not filtered
    width: int  # bytes of a pixel
    level: int

    def strip(self, first: int, last: int) -> _PngRows:
        """Rows `first` to `last` - 1, compressed."""
        filtered = self.filtered(first, last)
        encoder = zlib.compressobj(self.level, zlib.DEFLATED, -zlib.MAX_WBITS, zlib.DEF_MEM_LEVEL + 1)
        end = zlib.Z_FINISH if last == len(self.rows) else zlib.Z_SYNC_FLUSH
        return _PngRows(
            encoder.compress(filtered.data) + encoder.flush(end), zlib.adler32(filtered.data), filtered.size
        )

    def filtered(self, first: int, last: int) -> NDArray[np.uint8]:
        """(last - first, 1 + b) uint8: the rows, each under the filter with the smaller differences, and its number.

        The filters "average" and "Paeth" would save another 2 %, and take as long as the compression.
        """
        rows, width = self.rows[first:last], self.width
        out = np.empty((len(rows), 1 + rows.shape[1]), np.uint8)
        differences = out[:, 1:]
        out[:, 0] = _SUB
        differences[:, :width] = rows[:, :width]
        np.subtract(rows[:, width:], rows[:, :-width], out=differences[:, width:])
        up = rows - self.rows[first - 1 : last - 1] if first else np.concatenate([rows[:1], np.diff(rows, axis=0)])
        better = _magnitude(up) < _magnitude(differences)
        out[better, 0] = _UP
        differences[better] = up[better]
        return out


def _magnitude(differences: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """(n,) uint32: the sum of the magnitudes of a row of signed differences modulo 256."""
    out: NDArray[np.uint32] = np.minimum(differences, 0 - differences).sum(axis=1, dtype=np.uint32)
    return out


def _joined(strips: list[_PngRows], level: int) -> bytes:
    """The zlib stream of all strips."""
    low, high = 1, 0  # the halves of Adler-32: 1 plus the sum of the bytes, and the sum of the values that it took
    for strip in strips:
        high = (high + (strip.checksum >> 16) + strip.size * (low - 1)) % _ADLER
        low = (low + (strip.checksum & 0xFFFF) - 1) % _ADLER
    header = zlib.compress(b"", level)[:2]
    return b"".join([header, *(strip.data for strip in strips), struct.pack(">2H", high, low)])


def _chunk(name: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(data, zlib.crc32(name)))
