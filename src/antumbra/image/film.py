"""Writes films from pictures: .mp4 and .webm by ffmpeg, .gif by Pillow."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from ..extras import needed
from ..output import checked_output, replacing

SUFFIXES = (".mp4", ".webm", ".gif")
_CODECS = {
    ".mp4": ("libx264", ["-f", "mp4", "-crf", "18", "-movflags", "+faststart"]),
    ".webm": ("libvpx-vp9", ["-f", "webm", "-crf", "28", "-b:v", "0", "-row-mt", "1"]),
}
# Players take films without these words for BT.601 if they are small, and show other colours.
_COLOURS = ["-vf", "scale=out_color_matrix=bt709:out_range=tv"]
_COLOURS += [word for name in ("colorspace", "color_primaries", "color_trc") for word in (f"-{name}", "bt709")]
_TICK = 0.01  # seconds: GIF files count hundredths
_SHOWN = 8  # pictures that decide the colours of a GIF


def check_film(path) -> Path:
    """`path`, if a film can be written there; otherwise an InputError that names the cure. It is called early."""
    path = checked_output(path, SUFFIXES)
    if path.suffix.lower() in _CODECS:
        needed("imageio_ffmpeg", f"a {path.suffix.lower()} file", "video")
    return path


def write_film(
    pictures: Sequence[Path], path: Path, fps: float, progress: Callable[[int, int], Any] | None = None
) -> None:
    """Write pictures of one size as a film: the complete file, or nothing.

    Parameters
    ----------
    pictures : list of paths
        8-bit pictures, in order. If a side has an odd number of pixels, .mp4 and .webm repeat its last row or column,
        since their colours are stored for 2 x 2 pixels.
    path : Path
        From `check_film`.
    fps : float
        Pictures a second. A .gif rounds the end of each picture to hundredths of a second.
    progress : function of (done, total), optional

    Raises
    ------
    InputError
        If the film cannot be written.
    """
    with replacing(path) as temporary:
        if path.suffix.lower() == ".gif":
            _write_gif(pictures, temporary, fps, progress)
        else:
            _encode(pictures, temporary, fps, *_CODECS[path.suffix.lower()], progress)


def _encode(pictures, path: Path, fps: float, codec: str, options: list[str], progress) -> None:
    import imageio_ffmpeg

    size = _even(_pixels(pictures[0])).shape[1::-1]
    writer: Any = imageio_ffmpeg.write_frames(
        str(path), size, fps=fps, codec=codec, macro_block_size=1, quality=None, output_params=[*_COLOURS, *options],
        ffmpeg_log_level="error",
    )  # fmt: skip
    with closing(writer):
        writer.send(None)
        for k, picture in enumerate(pictures):
            writer.send(np.ascontiguousarray(_even(_pixels(picture))))
            if progress is not None:
                progress(k + 1, len(pictures))
    _check_whole(path, len(pictures))


def _check_whole(path: Path, count: int) -> None:
    """Raise an OSError unless a film has `count` pictures: nobody reports that ffmpeg failed, as on a full disk."""
    import imageio_ffmpeg

    try:
        found, _ = imageio_ffmpeg.count_frames_and_secs(str(path))
    except RuntimeError:  # it cannot be read at all
        found = 0
    if found != count:
        raise OSError(f"ffmpeg wrote {found} of {count} pictures; is the disk full?")


def _write_gif(pictures, path: Path, fps: float, progress) -> None:
    from PIL import Image

    some = pictures[:: -(-len(pictures) // _SHOWN)]
    colours = Image.fromarray(np.concatenate([_pixels(each) for each in some])).quantize(256)
    ends = np.round(np.arange(len(pictures) + 1) / fps / _TICK) * _TICK

    def shown() -> Iterator[Image.Image]:
        for k, picture in enumerate(pictures):
            yield Image.fromarray(_pixels(picture)).quantize(palette=colours, dither=Image.Dither.FLOYDSTEINBERG)
            if progress is not None:
                progress(k + 1, len(pictures))

    frames = shown()
    milliseconds = np.maximum(np.round(1000.0 * np.diff(ends)), 1000.0 * _TICK).astype(int).tolist()
    next(frames).save(
        path, format="GIF", save_all=True, append_images=frames, duration=milliseconds, loop=0, optimize=False
    )


def _pixels(path: Path) -> np.ndarray:
    """(H, W, 3) uint8."""
    from PIL import Image

    with Image.open(path) as image:
        return np.asarray(image.convert("RGB"))


def _even(pixels: np.ndarray) -> np.ndarray:
    """The picture with its last row and column repeated where their number is odd."""
    h, w = pixels.shape[:2]
    return np.pad(pixels, ((0, h % 2), (0, w % 2), (0, 0)), mode="edge")
