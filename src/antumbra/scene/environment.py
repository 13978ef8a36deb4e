"""Environment maps in files: Radiance .hdr and OpenEXR."""

from pathlib import Path

import numpy as np

from ..errors import InputError
from .files import checked_file, without_output

SUFFIXES = (".hdr", ".exr")
_MOST_PIXELS = 1 << 27


def read_environment(path: Path) -> np.ndarray:
    """The (h, w, 3) float64 linear radiance of a map.

    Raises
    ------
    InputError
        If the file is missing, of another kind or damaged, or holds no finite positive light.
    """
    checked_file(path, path.name)
    readers = {".hdr": _read_hdr, ".exr": _read_exr}
    if path.suffix.lower() not in readers:
        raise InputError(f"{path.name}: a sky is read from one of {', '.join(SUFFIXES)}; convert it")
    try:
        with without_output():
            image = readers[path.suffix.lower()](path)
    except Exception as error:  # libraries raise various exceptions for bad files
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise InputError(f"{path.name}: cannot be read ({reason}); is the file damaged?") from error
    if not np.isfinite(image).all() or (image < 0.0).any():
        raise InputError(f"{path.name}: holds light that is negative or not finite; a sky must have neither")
    return image.astype(np.float64)


def _read_exr(path: Path) -> np.ndarray:
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as file:
        channels = file.channels()
        missing = [name for name in "RGB" if name not in channels]
        if missing:
            raise ValueError(f"it has no channel {missing[0]}")
        return np.stack([channels[name].pixels for name in "RGB"], -1)


def _read_hdr(path: Path) -> np.ndarray:
    """RGBE pixels, plain or with run lengths."""
    data = path.read_bytes()
    header, blank, rest = data.partition(b"\n\n")
    size, _, rest = rest.partition(b"\n")
    words = size.split()
    if not header.startswith((b"#?RADIANCE", b"#?RGBE")) or not blank or len(words) != 4:
        raise ValueError("no Radiance picture")
    if words[0] != b"-Y" or words[2] != b"+X":
        raise ValueError("its rows do not run from top to bottom and left to right")
    h, w = int(words[1]), int(words[3])
    if not 0 < h * w <= _MOST_PIXELS:
        raise ValueError(f"{w}x{h} pixels")
    rgbe = _rows(np.frombuffer(rest, np.uint8), h, w).astype(np.float64)
    return np.where(rgbe[..., 3:] > 0, (rgbe[..., :3] + 0.5) * np.exp2(rgbe[..., 3:] - 136.0), 0.0)


def _rows(data: np.ndarray, h: int, w: int) -> np.ndarray:
    """(h, w, 4) uint8: the pixels of the rows."""
    if not (8 <= w < 32768 and data[:4].tolist() == [2, 2, w >> 8, w & 255]):
        return data[: 4 * h * w].reshape(h, w, 4)
    out, at = np.empty((h, 4, w), np.uint8), 0
    for row in out:
        if data[at : at + 4].tolist() != [2, 2, w >> 8, w & 255]:
            raise ValueError("a row does not begin with its length")
        at += 4
        for part in row:
            x = 0
            while x < w:
                n = int(data[at])
                run = n - 128 if n > 128 else n
                if not 0 < run <= w - x:
                    raise ValueError("a run is longer than its row")
                part[x : x + run] = data[at + 1] if n > 128 else data[at + 1 : at + 1 + run]
                at, x = at + (2 if n > 128 else 1 + run), x + run
    return out.transpose(0, 2, 1)
