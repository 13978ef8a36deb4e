"""The files of a data set: their paths, finished frames, atomic writing, and contact sheets.

A frame's record is written after its pictures, so a frame with a record is finished. Each file is written atomically.
"""

import hashlib
import json
from contextlib import suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..base.files import atomic_output
from ..kernels.elementary import log as log_of
from ..picture.heat_maps import ColourBar, Panel, panel_sheet
from ..picture.image_files import automatic_exposure, openexr, save_exr, save_png, to_srgb8
from ..work.scene_records import Record
from .dataset_layers import VIEW, light_layer

# --- Folders ----------------------------------------------------------------------------------------------------------


MANIFEST = "manifest.json"


class DatasetFolder:
    """The folder of a data set.

    path : Path
    digest : str
        Digest of the settings. Frames with another digest count as unfinished.
    """

    def __init__(self, path: Path, digest: str, frames: int, lights: int):
        self.path, self.digest, self.frames, self.lights = path, digest, frames, lights
        self._digits = max(4, len(str(frames - 1)))

    def name(self, k: int) -> str:
        """The number of frame k in file names."""
        return f"{k:0{self._digits}d}"

    def pictures(self, k: int) -> dict[str, str]:
        """The pictures of frame k: "exr" or a light's layer -> path relative to the folder."""
        masks = {light_layer(i): f"masks/{self.name(k)}.{light_layer(i)}.png" for i in range(self.lights)}
        return {"exr": f"frames/{self.name(k)}.exr", **masks}

    def files(self, k: int) -> list[str]:
        """All files of frame k, relative to the folder; the last one is its record."""
        return [*self.pictures(k).values(), f"frames/{self.name(k)}.json"]

    def at(self, path: Path) -> "DatasetFolder":
        """Another folder with the same settings."""
        return DatasetFolder(path, self.digest, self.frames, self.lights)

    def record(self, k: int) -> Record | None:
        """The record of frame k; None if the frame is not finished with these settings."""
        record = read_json(self._record(k))
        if record is None or record.pop("settings", None) != self.digest:
            return None
        files = record.get("files", {})
        complete = all(files.get(name, {}).get("bytes") == self._size(path) for name, path in self.pictures(k).items())
        return record if complete else None

    def write(self, k: int, channels: dict[str, np.ndarray], masks: list[np.ndarray], about: Record) -> None:
        """Write the pictures of frame k, then its record."""
        paths = self.pictures(k)
        note = json.dumps({"settings": self.digest, "frame": k, **about})
        for i, mask in enumerate(masks):
            save_png(mask, self.path / paths[light_layer(i)])
        save_exr(channels, self.path / paths["exr"], note)
        files = {name: self._file_record(path) for name, path in paths.items()}
        write_json({"settings": self.digest, "frame": k, **about, "files": files}, self._record(k))

    def prepare(self, *names: str) -> None:
        """Create the folder, or folders in it."""
        try:
            for path in [self.path / name for name in names] or [self.path]:
                path.mkdir(exist_ok=True)
        except OSError as error:
            raise InputError(f"{self.path}: cannot be created ({error.strerror}); choose another folder") from None

    def drop_others(self) -> None:
        """Remove frames rendered with other settings."""
        for path in (self.path / "frames").glob("*.json"):
            record = read_json(path) or {}
            if record.get("settings", self.digest) != self.digest:
                for file in record["files"].values():
                    (self.path / file["path"]).unlink(missing_ok=True)
                path.unlink()

    def _record(self, k: int) -> Path:
        return self.path / self.files(k)[-1]

    def _size(self, path: str) -> int:
        try:
            return (self.path / path).stat().st_size
        except OSError:
            return -1

    def _file_record(self, path: str) -> Record:
        with (self.path / path).open("rb") as stream:
            return {
                "path": path,
                "bytes": self._size(path),
                "sha256": hashlib.file_digest(stream, "sha256").hexdigest(),
            }


def read_json(path: Path) -> Record | None:
    """The object in a JSON file; None if there is none."""
    try:
        value = json.loads(path.read_bytes())
    except (OSError, ValueError):
        return None
    return value if isinstance(value, dict) else None


def write_json(value: Record, path: Path) -> None:
    """Write an indented JSON file, unless it already has this text."""
    text = json.dumps(value, indent=1, allow_nan=False) + "\n"
    with suppress(OSError, ValueError):
        if path.read_text() == text:
            return
    with atomic_output(path) as temporary:
        temporary.write_text(text)


# --- Contact sheets ---------------------------------------------------------------------------------------------------


_LIGHTS = 2  # maximum number of lights shown
_NOTHING = 40  # grey of the background


def contact_sheet(folder: Path, frame: int = 0) -> NDArray[np.uint8]:
    """(H, W, 3) uint8 sRGB: the layers of frame `frame`. Each id has its own colour; the background is dark grey.

    Raises
    ------
    InputError
        If the folder has no such frame.
    """
    manifest = read_json(folder / MANIFEST) or {}
    paths = sorted((folder / "frames").glob("*.exr"))
    path = next((p for p in paths if int(p.stem) == frame), None)
    if not manifest or path is None:
        raise InputError(f"{folder}: has no frame {frame} of a data set")
    layers = read_layers(path)
    lights = [light["layer"] for light in manifest["settings"]["lights"]][:_LIGHTS]
    covered = layers[f"{VIEW}.Triangle.X"] >= 0
    image = np.stack([layers[f"{VIEW}.Combined.{c}"] for c in "RGB"], axis=-1)
    normal = np.stack([layers[f"{VIEW}.Normal.{c}"] for c in "XYZ"], axis=-1)
    pictures = {
        f"{VIEW}.Combined": to_srgb8(image, automatic_exposure(image, covered)),
        f"{VIEW}.Depth": _grey(_nearness(layers[f"{VIEW}.Depth.Z"], covered)),
        f"{VIEW}.Normal": np.where(covered[..., None], np.rint(127.5 * (normal + 1.0)), _NOTHING).astype(np.uint8),
        f"{VIEW}.IndexOB": _coloured(layers[f"{VIEW}.IndexOB.X"]),
    }
    for light in lights:
        pictures[f"{light}.Visibility"] = _grey(layers[f"{light}.Visibility.X"])
        if f"{light}.Blocker.X" in layers:
            pictures[f"{light}.Blocker"] = _coloured(layers[f"{light}.Blocker.X"])
    bar = ColourBar(_grey(np.linspace(0.0, 1.0, 256)), [(0.0, "0"), (0.5, "0.5"), (1.0, "1")], "visibility; nearness")
    return panel_sheet([Panel(picture, [name]) for name, picture in pictures.items()], bar)


def read_layers(path: Path) -> dict[str, np.ndarray]:
    """The channels of an EXR file of a data set: name -> (H, W) float32, or int32 for ids."""
    with openexr().File(str(path), separate_channels=True) as file:
        pixels = {name: channel.pixels for name, channel in file.channels().items()}
    return {name: p.view(np.int32) if p.dtype == np.uint32 else p for name, p in pixels.items()}


def _grey(values: np.ndarray) -> NDArray[np.uint8]:
    grey = np.rint(255.0 * np.clip(values, 0.0, 1.0)).astype(np.uint8)
    return np.repeat(grey[..., None], 3, axis=-1)


def _nearness(depth: np.ndarray, covered: NDArray[np.bool_]) -> np.ndarray:
    """1 for the nearest pixel and 0.15 for the farthest, logarithmic in depth; 0 in the background."""
    if not covered.any():
        return np.zeros(depth.shape)
    log = log_of(np.where(covered, depth, depth[covered].min()))
    return np.where(covered, 1.0 - 0.85 * (log - log.min()) / max(float(np.ptp(log[covered])), 1e-6), 0.0)


def _coloured(ids: NDArray[np.int32]) -> NDArray[np.uint8]:
    """A colour for each id, dark grey for -1."""
    colours = np.random.default_rng(1).integers(70, 256, (997, 3), np.uint8)
    return np.where(ids[..., None] >= 0, colours[ids % 997], np.uint8(_NOTHING))
