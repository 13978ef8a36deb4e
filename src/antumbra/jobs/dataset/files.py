"""The files of a data set: where they are, which frames are finished, and how they are written.

A frame's record is written after its pictures, so a frame with a record is finished. Each file is written whole or not
at all.
"""

import hashlib
import json
from contextlib import suppress
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...files import atomic_output
from ...picture.image_files import save_exr, save_png
from .layers import light_layer

MANIFEST = "manifest.json"


class Folder:
    """The folder of a data set.

    path : Path
    digest : str
        Of the settings. Frames with another digest are not finished.
    """

    def __init__(self, path: Path, digest: str, frames: int, lights: int):
        self.path, self.digest, self.frames, self.lights = path, digest, frames, lights
        self._digits = max(4, len(str(frames - 1)))

    def name(self, k: int) -> str:
        """The number of frame k, as its files have it."""
        return f"{k:0{self._digits}d}"

    def pictures(self, k: int) -> dict[str, str]:
        """The pictures of frame k: "exr" or a light's layer -> path in the folder."""
        masks = {light_layer(i): f"masks/{self.name(k)}.{light_layer(i)}.png" for i in range(self.lights)}
        return {"exr": f"frames/{self.name(k)}.exr", **masks}

    def files(self, k: int) -> list[str]:
        """All files of frame k in the folder; the last one is its record."""
        return [*self.pictures(k).values(), f"frames/{self.name(k)}.json"]

    def at(self, path: Path) -> "Folder":
        """Another folder of the same settings."""
        return Folder(path, self.digest, self.frames, self.lights)

    def record(self, k: int) -> dict | None:
        """The record of frame k; None if it is not finished with these settings."""
        found = read_json(self._record(k))
        if found is None or found.pop("settings", None) != self.digest:
            return None
        files = found.get("files", {})
        whole = all(files.get(name, {}).get("bytes") == self._size(path) for name, path in self.pictures(k).items())
        return found if whole else None

    def write(self, k: int, channels: dict[str, np.ndarray], masks: list[np.ndarray], about: dict) -> None:
        """Write the pictures of frame k, then its record."""
        paths = self.pictures(k)
        note = json.dumps({"settings": self.digest, "frame": k, **about})
        for i, mask in enumerate(masks):
            save_png(mask, self.path / paths[light_layer(i)])
        save_exr(channels, self.path / paths["exr"], note)
        files = {name: self._digested(path) for name, path in paths.items()}
        write_json({"settings": self.digest, "frame": k, **about, "files": files}, self._record(k))

    def prepare(self, *names: str) -> None:
        """Make the folder, or folders in it."""
        try:
            for path in [self.path / name for name in names] or [self.path]:
                path.mkdir(exist_ok=True)
        except OSError as error:
            raise InputError(f"{self.path}: cannot be made ({error.strerror}); choose another folder") from None

    def drop_others(self) -> None:
        """Remove the frames that were made with other settings."""
        for path in (self.path / "frames").glob("*.json"):
            found = read_json(path) or {}
            if found.get("settings", self.digest) != self.digest:
                for file in found["files"].values():
                    (self.path / file["path"]).unlink(missing_ok=True)
                path.unlink()

    def _record(self, k: int) -> Path:
        return self.path / self.files(k)[-1]

    def _size(self, path: str) -> int:
        try:
            return (self.path / path).stat().st_size
        except OSError:
            return -1

    def _digested(self, path: str) -> dict:
        with (self.path / path).open("rb") as stream:
            return {
                "path": path,
                "bytes": self._size(path),
                "sha256": hashlib.file_digest(stream, "sha256").hexdigest(),
            }


def read_json(path: Path) -> dict | None:
    """The object in a JSON file; None if there is none."""
    try:
        found = json.loads(path.read_bytes())
    except (OSError, ValueError):
        return None
    return found if isinstance(found, dict) else None


def write_json(value: dict, path: Path) -> None:
    """Write a JSON file that is easy to read, unless it has this text already."""
    text = json.dumps(value, indent=1, allow_nan=False) + "\n"
    with suppress(OSError, ValueError):
        if path.read_text() == text:
            return
    with atomic_output(path) as temporary:
        temporary.write_text(text)
