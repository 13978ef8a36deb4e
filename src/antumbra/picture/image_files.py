"""Image files: tone mapping for screens, PNG files for viewing, EXR files for measurements, and films."""

import json
import math
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import choice, number, quoted, vector
from ..base.errors import InputError
from ..base.extras import import_extra
from ..base.files import atomic_output, checked_output
from ..base.forks import hold_during_fork
from ..base.wording import some_of
from ..kernels.elementary import exp
from ..kernels.parallel import map_in_threads, thread_count
from ..kernels.small_matrices import dot
from ..scene.materials import LINEAR, linear_to_srgb, srgb_to_linear
from .picture_records import picture_record, plain
from .png_files import png_file
from .sky_background import daylight_behind, seen_daylight

# --- Tone mapping: exposure, highlight roll-off, sRGB -----------------------------------------------------------------


LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
"""Rec. 709 weights of linear red, green and blue."""

# Automatic exposure maps the percentile PERCENTILE of the luminance of visible surfaces to the share BRIGHT of white.
# If the median is then below MIDDLE, it brightens the picture by up to MOST_BRIGHTER, so that highlights roll off, but
# only until the percentile WIDE reaches WIDE_AT_MOST: a wide bright floor keeps its shades.
PERCENTILE = 97.0
BRIGHT = 0.75  # leaves room for highlights
MIDDLE = 0.4
MOST_BRIGHTER = 3.0
WIDE = 85.0
WIDE_AT_MOST = 0.75
DARK = 2.0  # daylight on the ground, as a multiple of white, beyond which half of its stops are taken off the exposure
SHOULDER = 0.6  # light below this stays linear; light above it rolls off towards white

_TOP = 4.0  # end of the table; the roll-off reaches 8-bit white long before it
_ENTRIES = 1 << 16
_EXPOSURE_PIXELS = 1 << 18  # pixels that automatic exposure samples, about
_ROWS = 64  # rows converted at a time, so that temporaries stay in the cache


def automatic_exposure(image: NDArray[np.float32], mask: NDArray[np.bool_]) -> float:
    """The exposure that makes a picture bright but not clipped; 1.0 if there is no light.

    Parameters
    ----------
    image : (H, W, 3) float32, linear
    mask : (H, W) bool
        Pixels that count.
    """
    step = max(1, math.isqrt(mask.size // _EXPOSURE_PIXELS))
    sampled = np.zeros_like(mask)
    sampled[::step, ::step] = mask[::step, ::step]
    pixels = np.flatnonzero(sampled if sampled.any() else mask)
    with np.errstate(invalid="ignore"):  # non-finite pixels do not count
        luminance = dot(_rows_at(image, pixels), LUMINANCE)
    luminance = luminance[np.isfinite(luminance) & (luminance > 0.0)]
    if not len(luminance):
        return 1.0
    middle, wide, high = (max(float(v), 1e-30) for v in percentiles(luminance, (50.0, WIDE, PERCENTILE)))
    exposure = BRIGHT / high
    return exposure * max(1.0, min(MIDDLE / (middle * exposure), WIDE_AT_MOST / (wide * exposure), MOST_BRIGHTER))


def percentiles(values: NDArray[np.float32], percentages: Sequence[float]) -> NDArray[np.float64]:
    """``np.percentile`` of (n,) float32 values, n > 0, without importing numpy.ma, which takes long."""
    at = np.array(percentages) / 100.0 * (len(values) - 1)
    low = at.astype(int)
    high = np.minimum(low + 1, len(values) - 1)
    ordered = np.partition(values, np.concatenate([low, high]))
    step, share = ordered[high] - ordered[low], at - low
    return np.asarray(np.where(share < 0.5, ordered[low] + step * share, ordered[high] - step * (1.0 - share)))


def roll_off(x: np.ndarray) -> np.ndarray:
    """Map linear light >= 0 to [0, 1]: unchanged up to `SHOULDER`, then towards 1, with a continuous derivative."""
    room = 1.0 - SHOULDER
    return np.where(x <= SHOULDER, x, 1.0 - room * exp(-np.maximum(x - SHOULDER, 0.0) / room))


def to_srgb8(image: NDArray[np.floating], exposure: float) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 sRGB of linear light times `exposure`, with rolled-off highlights.

    NaN and negative light are black. The curve is a table of 65536 entries; at black, where it is steepest, an entry
    spans a fifth of an 8-bit step.
    """
    return _by_rows(lambda rows: _rows_to_srgb8(image[rows], exposure), image)


def _rows_to_srgb8(image: NDArray[np.floating], exposure: float) -> NDArray[np.uint8]:
    with np.errstate(invalid="ignore", over="ignore"):
        entry = image * np.float32(min(exposure * (_ENTRIES / _TOP), 3e38))
        np.fmax(entry, np.float32(0.0), out=entry)  # fmax and fmin drop NaN
        np.fmin(entry, np.float32(_ENTRIES - 1), out=entry)
    return np.take(_curve(), entry.astype(np.uint16), mode="clip")  # "clip" is the fastest, and no index needs it


def _by_rows(function: Callable[[slice], NDArray[np.uint8]], image: np.ndarray) -> NDArray[np.uint8]:
    """The results of a function of a few rows of an image at a time, in threads, below each other."""
    strips = [slice(y, y + _ROWS) for y in range(0, max(len(image), 1), _ROWS)]
    return np.concatenate(map_in_threads(function, strips))


@cache
def _curve() -> NDArray[np.uint8]:
    """The table of `to_srgb8`."""
    x = (np.arange(_ENTRIES) + 0.5) * (_TOP / _ENTRIES)
    return np.round(255.0 * linear_to_srgb(roll_off(x))).astype(np.uint8)


# --- PNG and EXR files ------------------------------------------------------------------------------------------------

IMAGE_SUFFIXES = (".png", ".exr")
MAX_EXPOSURE = 1e30  # the limit of intensities
_EXR_MAGIC = b"v/1\x01"
_writing_exr = threading.Lock()  # OpenEXR has one number of threads for all files
hold_during_fork(_writing_exr)
_NOTE = "antumbra"  # keyword of the text chunk in a PNG, name of the attribute in an EXR


def is_linear(path: Path) -> bool:
    """Whether a picture file keeps linear light."""
    return path.suffix.lower() == ".exr"


def check_output(path: str | os.PathLike[str]) -> Path:
    """Check, before a long render, that a picture can be written to `path`; InputError with the remedy if not."""
    file = checked_output(path, IMAGE_SUFFIXES)
    if is_linear(file):
        openexr()
    return file


def openexr() -> ModuleType:
    """The module OpenEXR; InputError if it is not installed."""
    return import_extra("OpenEXR", "an .exr file", "exr")


def checked_exposure(exposure: float) -> float:
    """`exposure` as a float; InputError unless it lies between 0 and `MAX_EXPOSURE`."""
    return number(exposure, "exposure", 0.0, MAX_EXPOSURE)


def frame_exposure(frame: Any) -> float:
    """The automatic exposure of ``save_frame(frame, "x.png")``, which shows a dark model on a ground dark."""
    exposure = automatic_exposure(frame.image, frame.mask)
    daylight = 0.0 if frame.ground is None else sum(sky.intensity for sky in seen_daylight(frame))
    return exposure / math.sqrt(max(1.0, exposure * daylight / DARK))


def save_frame(
    frame: Any,
    path: str | os.PathLike[str],
    exposure: float | None = None,
    note: str | None = None,
    background: str | ArrayLike | None = None,
) -> None:
    """Write a `Frame` to an image file; see `Frame.save`.

    Parameters
    ----------
    frame : Frame
    path : str or path-like
        ``.png``: 8-bit sRGB with soft highlights. ``.exr``: the channels of `exr_channels`.
    exposure : float or None
        Factor on the light of a PNG; None: automatic. An EXR ignores it.
    note : str or None
        Text to store in the file; `note_of` reads it. None: an EXR has the settings of the frame.
    background : None, "transparent" or (3,) float
        Background of a PNG, as in `Frame.save`. An EXR ignores it.

    Raises
    ------
    InputError
        If the suffix is unknown, the exposure is not positive, or the path cannot be written.

    Notes
    -----
    The file is written under a temporary name and then renamed, so `path` has the complete file or its old contents.
    """
    file = check_output(path)
    if exposure is not None:
        exposure = checked_exposure(exposure)
    background = _check_background(background)
    if file.suffix.lower() == ".png":
        save_png(screen_picture(frame, frame_exposure(frame) if exposure is None else exposure, background), file, note)
    else:
        save_exr(exr_channels(frame), file, _frame_note(frame) if note is None else note, exr_header(frame))


def _frame_note(frame: Any) -> str | None:
    """The settings of a frame, as the command stores them; None for a frame that was not rendered."""
    if frame.options is None:
        return None
    return json.dumps(plain(picture_record(frame.camera, frame.lights, frame.options)))


def _check_background(background: str | ArrayLike | None) -> str | NDArray[np.float64] | None:
    if background is None:
        return None
    if isinstance(background, str):
        name: str = choice(background, "background", ("transparent",))
        return name
    colour = vector(background, "background")
    if not ((colour >= 0.0) & (colour <= 1.0)).all():
        raise InputError(f"background is {quoted(background)}; an sRGB colour has three numbers from 0 to 1")
    return colour


def screen_picture(frame: Any, exposure: float, background: str | ArrayLike | None = None) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 sRGB of a frame, or (H, W, 4) with alpha if `background` is "transparent".

    Without `background`, the frame's backdrop is shown, if it has one. With a background or backdrop, a pixel that
    surfaces cover in part mixes the colour of the surfaces with the background, in linear light. Shadows on the ground
    dim the background; where it is transparent they are black, see `_transparent`. A daylight that the exposure would
    turn white is dimmer, see `daylight_behind`.
    """
    sky = colour = None
    if background is None and frame.backdrop is None:
        daylight = daylight_behind(frame, exposure)
        if daylight is None:
            return to_srgb8(frame.image, exposure)
        sky, colour = daylight[0], daylight[0] * np.float32(daylight[1])
    elif not isinstance(background, str):
        colour = _background(frame, background)
    share, lost = frame.coverage[..., None], None if frame.ground is None else frame.ground.lost

    def screen_rows(rows: slice) -> NDArray[np.uint8]:
        surfaces = _rows_to_srgb8(frame.image[rows], exposure)
        pixels = np.flatnonzero(share[rows] < 1.0)
        some, light = _rows_at(share[rows], pixels), _rows_at(frame.image[rows], pixels)
        if sky is not None:
            light = np.maximum(light - (1.0 - some) * _rows_at(sky[rows], pixels), 0.0)
        uncovered = _rows_to_srgb8(light / np.maximum(some, 1e-6), exposure)
        if colour is not None:
            mixed = some * LINEAR[uncovered] + (1.0 - some) * _rows_at(colour[rows], pixels)
            uncovered = np.round(255.0 * linear_to_srgb(mixed)).astype(np.uint8)
        surfaces.reshape(-1, 3)[pixels] = uncovered
        if colour is None:
            return _transparent(surfaces, share[rows], None if lost is None else lost[rows])
        return surfaces

    return _by_rows(screen_rows, frame.image)


def _background(frame: Any, background: ArrayLike | None) -> np.ndarray:
    """(H, W, 3), linear: a background colour under the shadows of a frame, or its backdrop."""
    colour: np.ndarray = frame.backdrop
    if background is not None:
        colour = srgb_to_linear(vector(background, "background")).astype(np.float32)
        colour = colour if frame.ground is None else colour * frame.ground.share
    return np.broadcast_to(colour, frame.image.shape)


def _rows_at(image: np.ndarray, pixels: NDArray[np.int64]) -> np.ndarray:
    """(k, c): pixels of an image, (h, w, c), by their flat indices. It is three times as fast as a boolean index."""
    return np.take(image.reshape(-1, image.shape[-1]), pixels, axis=0)


def _transparent(
    surfaces: NDArray[np.uint8], share: NDArray[np.float32], lost: NDArray[np.float32] | None
) -> NDArray[np.uint8]:
    """(H, W, 4) uint8 sRGB with alpha: surfaces that cover a share of each pixel, and black shadows behind them.

    share : (H, W, 1) float32, covered share of each pixel
    lost : (H, W) float32, `Ground.lost`; None: no shadows

    Viewers blend the sRGB values of a PNG. The alpha of a shadow is therefore its loss in sRGB, so that a background
    behind the PNG looks like one rendered with the shadow.
    """
    alpha: np.ndarray = share
    if lost is not None:
        dark = (1.0 - linear_to_srgb(1.0 - lost))[..., None]
        alpha = share + (1.0 - share) * dark
        surfaces = np.round(surfaces * (share / np.maximum(alpha, 1e-6))).astype(np.uint8)
    return np.concatenate([surfaces, np.round(255.0 * alpha).astype(np.uint8)], -1)


def save_exr(
    channels: dict[str, np.ndarray], path: Path, note: str | None = None, attributes: dict[str, str] | None = None
) -> None:
    """Write channels, (H, W) float32 or uint32 ("RGB": (H, W, 3)), to a complete file or to none.

    attributes : further attributes of the header
    """
    with atomic_output(path) as temporary:
        write_exr(channels, temporary, note, attributes)


def save_png(rgb: NDArray[np.uint8], path: Path, note: str | None = None) -> None:
    """Write (H, W, 3) or (H, W, 4) uint8 sRGB, or (H, W) uint8 grey, to a complete file or to none."""
    with atomic_output(path) as temporary:
        write_png(rgb, temporary, note)


def png_bytes(rgb: NDArray[np.uint8]) -> bytes:
    """The contents of a PNG file of (H, W, 3) uint8 sRGB."""
    return png_file(rgb, {})


def exr_channels(frame: Any) -> dict[str, np.ndarray]:
    """The channels of an EXR file: name -> (H, W) float32, or uint32 for ids. LAYER.C is channel C of a layer.

    R, G, B, A (1 where a surface is seen); shadow.NAME, the visible share of each light; depth.Z, normal.X/Y/Z,
    position.X/Y/Z, triangle.id, and of int64 ids triangle.high, the upper 32 bits. With a ground, A is `Ground.lost`
    where no surface is seen, and ground.R/G/B is `Ground.share`. `Frame.layers` add light.NAME.R/G/B, albedo.R/G/B,
    indirect.R/G/B and object.id.
    """
    g, layers = frame.gbuffer, frame.layers
    names = frame.names or tuple(map(str, range(len(frame.visibility))))
    channels = {**_split("", frame.image), "A": frame.mask, "depth.Z": g.depth, **_ids("triangle", g.face)}
    if frame.ground is not None:
        channels |= {"A": np.where(frame.mask, np.float32(1.0), frame.ground.lost)}
        channels |= _split("ground.", frame.ground.share)
    channels |= _split("normal.", g.normal, "XYZ") | _split("position.", g.position, "XYZ")
    channels |= {f"shadow.{name}": fraction for name, fraction in zip(names, frame.visibility)}
    if layers is not None:
        channels |= _split("albedo.", layers.albedo) | {"object.id": layers.object}
        for name, image in zip(names, layers.lights):
            channels |= _split(f"light.{name}.", image)
        if layers.indirect is not None:
            channels |= _split("indirect.", layers.indirect)
    return {name: exr_values(values) for name, values in channels.items()}


def exr_header(frame: Any) -> dict[str, str]:
    """Attributes of an EXR file: the values in the background, and the origin of positions."""
    loss = "" if frame.ground is None else " (the share of light lost where the ground is in shadow, see ground.*)"
    return {
        "software": "Antumbra",
        "background": f"A is 0{loss}, depth.Z is infinity, shadow.* is 1, ids are 4294967295 (-1), all else is 0",
        "positionOrigin": json.dumps(frame.gbuffer.origin.tolist()),  # world position = position + this
    }


def exr_values(values: np.ndarray) -> np.ndarray:
    """Convert to a type that OpenEXR has. It has no signed integers: int32 ids become UINT with the same bits."""
    values = np.ascontiguousarray(values)
    if values.dtype == np.uint32:
        return values
    return values.view(np.uint32) if values.dtype == np.int32 else values.astype(np.float32, copy=False)


def _ids(layer: str, values: np.ndarray) -> dict[str, np.ndarray]:
    if values.dtype == np.int32:
        return {f"{layer}.id": values}
    return {f"{layer}.id": (values & 0xFFFFFFFF).astype(np.uint32), f"{layer}.high": (values >> 32).astype(np.int32)}


def _split(layer: str, values: np.ndarray, names: str = "RGB") -> dict[str, np.ndarray]:
    return {f"{layer}{c}": values[..., k] for k, c in enumerate(names)}


def note_of(path: Path) -> str | None:
    """The note in an image file, read from its header alone; None without a note, or if it is not an image file."""
    try:
        if is_linear(path):
            with path.open("rb") as stream:
                if stream.read(4) != _EXR_MAGIC:  # the library would report it on standard error
                    return None
            with openexr().File(str(path), header_only=True) as file:
                note: str | None = file.header().get(_NOTE)
                return note
        from PIL import Image

        with Image.open(path, formats=("PNG",)) as image:
            note = image.info.get(_NOTE)
            return note
    except Exception:  # the libraries raise various exceptions for bad files
        return None


def write_png(rgb: NDArray[np.uint8], path: Path, note: str | None) -> None:
    """Write an sRGB picture, (h, w, 3 or 4) or grey (h, w) uint8, with an optional note in its metadata."""
    path.write_bytes(png_file(rgb, {} if note is None else {_NOTE: note}))


def write_exr(
    channels: dict[str, np.ndarray], path: Path, note: str | None, attributes: dict[str, str] | None = None
) -> None:
    """Write channels, (H, W) or RGB (H, W, 3) float32, to an EXR file. Raises OSError."""
    module = openexr()
    header = {**(attributes or {}), "compression": module.ZIP_COMPRESSION, "type": module.scanlineimage}
    if note is not None:
        header[_NOTE] = note
    try:
        with _exr_threads(), module.File(header, channels) as file:
            file.write(str(path))
    except RuntimeError as error:  # the library turns system errors into RuntimeError
        raise OSError(str(error).rpartition('". ')[2].rstrip(".")) from error


@contextmanager
def _exr_threads() -> Iterator[None]:
    """Let OpenEXR compress on all cores. Its threads end with the block, because a forked child could not use them."""
    set_count = getattr(openexr(), "set_global_thread_count", lambda count: None)  # missing in versions before 3.4
    with _writing_exr:
        set_count(thread_count(None) if thread_count(None) > 1 else 0)
        try:
            yield
        finally:
            set_count(0)


# --- Films: .mp4 and .webm by ffmpeg, .gif by Pillow ------------------------------------------------------------------

FILM_SUFFIXES = (".mp4", ".webm", ".gif")
_CODECS = {
    ".mp4": ("libx264", ["-f", "mp4", "-crf", "18", "-movflags", "+faststart"]),
    ".webm": ("libvpx-vp9", ["-f", "webm", "-crf", "28", "-b:v", "0", "-row-mt", "1"]),
}
# Without these options, players take small films for BT.601 and show wrong colours.
_COLOURS = ["-vf", "scale=out_color_matrix=bt709:out_range=tv"]
_COLOURS += [word for name in ("colorspace", "color_primaries", "color_trc") for word in (f"-{name}", "bt709")]
_SAME_BYTES = ["-fflags", "+bitexact"]  # no random identifiers
_TICK = 0.01  # seconds: GIF files count hundredths
_PALETTE_PICTURES = 8  # pictures from which the palette of a GIF is computed, at most


def check_film(path: str | os.PathLike[str]) -> Path:
    """Check, before a long render, that a film can be written to `path`; InputError with the remedy if not."""
    file = checked_output(path, FILM_SUFFIXES)
    if file.suffix.lower() in _CODECS:
        import_extra("imageio_ffmpeg", f"a {file.suffix.lower()} file", "video")
    return file


def write_film(
    pictures: Sequence[Path], path: Path, fps: float, progress: Callable[[int, int], Any] | None = None
) -> None:
    """Write pictures of one size as a film, to a complete file or to none.

    Parameters
    ----------
    pictures : list of paths
        8-bit pictures, in order. .mp4 and .webm store colours for 2 x 2 pixels, so an odd width or height is padded by
        repeating the last column or row.
    path : Path
        From `check_film`.
    fps : float
        Pictures per second. A .gif rounds the end of each picture to hundredths of a second.
    progress : function of (done, total), optional

    Raises
    ------
    InputError
        If the film cannot be written.
    """
    with atomic_output(path) as temporary:
        if path.suffix.lower() == ".gif":
            _write_gif(pictures, temporary, fps, progress)
        else:
            _encode(pictures, temporary, fps, *_CODECS[path.suffix.lower()], progress)


def _encode(
    pictures: Sequence[Path],
    path: Path,
    fps: float,
    codec: str,
    options: list[str],
    progress: Callable[[int, int], Any] | None,
) -> None:
    import imageio_ffmpeg

    size = _even(_pixels(pictures[0])).shape[1::-1]
    writer: Any = imageio_ffmpeg.write_frames(
        str(path),
        size,
        fps=fps,
        codec=codec,
        macro_block_size=1,
        quality=None,
        output_params=[*_COLOURS, *options, *_SAME_BYTES],
        ffmpeg_log_level="error",
    )
    with closing(writer):
        writer.send(None)
        for k, picture in enumerate(pictures):
            writer.send(np.ascontiguousarray(_even(_pixels(picture))))
            if progress is not None:
                progress(k + 1, len(pictures))
    _check_frame_count(path, len(pictures))


def _check_frame_count(path: Path, count: int) -> None:
    """Raise an OSError unless a film has `count` pictures: failures of ffmpeg, as on a full disk, go unreported."""
    import imageio_ffmpeg

    try:
        n_frames, _ = imageio_ffmpeg.count_frames_and_secs(str(path))
    except RuntimeError:  # unreadable
        n_frames = 0
    if n_frames != count:
        raise OSError(f"ffmpeg wrote {some_of(n_frames, count, 'picture')}; is the disk full?")


def _write_gif(pictures: Sequence[Path], path: Path, fps: float, progress: Callable[[int, int], Any] | None) -> None:
    from PIL import Image

    samples = pictures[:: -(-len(pictures) // _PALETTE_PICTURES)]
    palette = Image.fromarray(np.concatenate([_pixels(picture) for picture in samples])).quantize(256)
    ends = np.round(np.arange(len(pictures) + 1) / fps / _TICK) * _TICK

    def quantized() -> Iterator[Image.Image]:
        for k, picture in enumerate(pictures):
            yield Image.fromarray(_pixels(picture)).quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG)
            if progress is not None:
                progress(k + 1, len(pictures))

    frames = quantized()
    milliseconds = np.maximum(np.round(1000.0 * np.diff(ends)), 1000.0 * _TICK).astype(int).tolist()
    next(frames).save(
        path, format="GIF", save_all=True, append_images=frames, duration=milliseconds, loop=0, optimize=False
    )


def _pixels(path: Path) -> NDArray[np.uint8]:
    """(H, W, 3) uint8."""
    from PIL import Image

    with Image.open(path, formats=("PNG", "JPEG")) as image:  # those that this program has written
        return np.asarray(image.convert("RGB"))


def _even(pixels: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Pad odd widths and heights by repeating the last column or row."""
    h, w = pixels.shape[:2]
    return np.pad(pixels, ((0, h % 2), (0, w % 2), (0, 0)), mode="edge")
