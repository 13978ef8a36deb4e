"""A contact sheet: the layers of a frame of a data set as a picture, read from its files."""

from pathlib import Path

import numpy as np

from ...errors import InputError
from ...picture.heat_maps import ColourBar, Panel, sheet
from ...picture.image_files import automatic_exposure, to_srgb8
from .files import MANIFEST, read_json
from .layers import VIEW

_LIGHTS = 2  # that are shown
_NOTHING = 40  # grey of the background


def contact_sheet(folder: Path, frame: int = 0) -> np.ndarray:
    """(H, W, 3) uint8 sRGB: what frame `frame` holds. Each id has a colour of its own, the background none.

    Raises
    ------
    InputError
        If the folder has no such frame.
    """
    found = read_json(folder / MANIFEST) or {}
    paths = sorted((folder / "frames").glob("*.exr"))
    path = next((p for p in paths if int(p.stem) == frame), None)
    if not found or path is None:
        raise InputError(f"{folder}: has no frame {frame} of a data set")
    layers = read_layers(path)
    lights = [light["layer"] for light in found["settings"]["lights"]][:_LIGHTS]
    seen = layers[f"{VIEW}.Triangle.X"] >= 0
    image = np.stack([layers[f"{VIEW}.Combined.{c}"] for c in "RGB"], axis=-1)
    normal = np.stack([layers[f"{VIEW}.Normal.{c}"] for c in "XYZ"], axis=-1)
    pictures = {
        f"{VIEW}.Combined": to_srgb8(image, automatic_exposure(image, seen)),
        f"{VIEW}.Depth": _grey(_nearness(layers[f"{VIEW}.Depth.Z"], seen)),
        f"{VIEW}.Normal": np.where(seen[..., None], np.rint(127.5 * (normal + 1.0)), _NOTHING).astype(np.uint8),
        f"{VIEW}.IndexOB": _coloured(layers[f"{VIEW}.IndexOB.X"]),
    }
    for light in lights:
        pictures[f"{light}.Visibility"] = _grey(layers[f"{light}.Visibility.X"])
        if f"{light}.Blocker.X" in layers:
            pictures[f"{light}.Blocker"] = _coloured(layers[f"{light}.Blocker.X"])
    bar = ColourBar(_grey(np.linspace(0.0, 1.0, 256)), [(0.0, "0"), (0.5, "0.5"), (1.0, "1")], "visibility; nearness")
    return sheet([Panel(picture, [name]) for name, picture in pictures.items()], bar)


def read_layers(path: Path) -> dict[str, np.ndarray]:
    """The channels of an EXR file of a data set: name -> (H, W) float32, or int32 for ids."""
    import OpenEXR

    with OpenEXR.File(str(path), separate_channels=True) as file:
        pixels = {name: channel.pixels for name, channel in file.channels().items()}
    return {name: p.view(np.int32) if p.dtype == np.uint32 else p for name, p in pixels.items()}


def _grey(values: np.ndarray) -> np.ndarray:
    grey = np.rint(255.0 * np.clip(values, 0.0, 1.0)).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=-1)


def _nearness(depth: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """1 for the nearest pixel and 0.15 for the farthest, in ratios of depth; 0 in the background."""
    if not seen.any():
        return np.zeros(depth.shape)
    log = np.log(np.where(seen, depth, depth[seen].min()))
    return np.where(seen, 1.0 - 0.85 * (log - log.min()) / max(float(np.ptp(log[seen])), 1e-6), 0.0)


def _coloured(ids: np.ndarray) -> np.ndarray:
    """A colour for each id, dark grey for -1."""
    colours = np.random.default_rng(1).integers(70, 256, (997, 3), np.uint8)
    return np.where(ids[..., None] >= 0, colours[ids % 997], np.uint8(_NOTHING))
