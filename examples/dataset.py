"""A training data set, read with torch if it is installed: python examples/dataset.py [FOLDER]

It renders the room that comes with the package, with random cameras and lights, and reads the files as tensors, or as
NumPy arrays without torch. A second run renders nothing.
"""

import json
import sys
import tempfile
from pathlib import Path

import numpy as np
import OpenEXR

import antumbra as at

try:
    from torch import from_dlpack
    from torch.utils.data import DataLoader, Dataset
except ImportError:
    DataLoader, Dataset, from_dlpack = None, object, np.from_dlpack

CAMERAS, LIGHTS = 6, 2


class Shadows(Dataset):
    """The frames of a data set as dictionaries of tensors (C, H, W), where C counts the lights or X, Y, Z."""

    def __init__(self, folder: Path):
        self.folder, manifest = folder, json.loads((folder / "manifest.json").read_text())
        self.frames = manifest["frames"]
        self.lights = [light["layer"] for light in manifest["settings"]["lights"]]

    def __len__(self) -> int:
        return len(self.frames)

    def __getitem__(self, k: int) -> dict:
        path = self.folder / self.frames[k]["files"]["exr"]["path"]
        with OpenEXR.File(str(path), separate_channels=True) as file:
            layers = {name: channel.pixels for name, channel in file.channels().items()}
        ids = layers["ViewLayer.Triangle.X"].view(np.int32)  # EXR integers are unsigned; -1 is the background
        stacks = {
            "depth": [np.where(ids >= 0, layers["ViewLayer.Depth.Z"], 0)],
            "normal": [layers[f"ViewLayer.Normal.{axis}"] for axis in "XYZ"],
            "object": [layers["ViewLayer.IndexOB.X"].view(np.int32)],
            "visibility": [layers[f"{light}.Visibility.X"] for light in self.lights],
            "blocker": [layers[f"{light}.BlockerIndexOB.X"].view(np.int32) for light in self.lights],
        }
        return {name: from_dlpack(np.stack(arrays)) for name, arrays in stacks.items()}


if __name__ == "__main__":
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else tempfile.mkdtemp()) / "shadows"
    scene = at.examples.room()
    dataset = at.dataset(scene, folder, random=CAMERAS, random_lights=LIGHTS, seed=5, size=(96, 64), spp=4)
    rendered = f"{dataset.rendered} of them rendered now, in {dataset.seconds:.1f} s"
    print(f"{dataset.frames} frames of {scene.name}, {rendered}")

    shadows = Shadows(folder)
    for name, values in shadows[0].items():
        print(f"{name:10} {tuple(values.shape)} {values.dtype}")
    if DataLoader is not None:
        for batch in DataLoader(shadows, batch_size=3, shuffle=True):
            print("a batch:", tuple(batch["visibility"].shape), f"mean visibility {batch['visibility'].mean():.3f}")

    # Results in memory are also shared with other libraries without a copy.
    frame = at.render(scene, scene.default_camera(96, 64), spp=16)
    bits = from_dlpack(frame.bits[0].view(np.int64))  # bit s of a pixel: sample s of the light is hidden
    hidden = sum((bits >> s) & 1 for s in range(16))
    print(f"hidden samples, by bits: {int(hidden.sum())} of {frame.rays}")
