"""A folder of vertex frames: a square that moves over a floor."""

import numpy as np

FLOOR = [[-2, 0, -2], [2, 0, -2], [2, 0, 2], [-2, 0, 2]]
BLOCKER = [[-0.5, 1, -0.5], [0.5, 1, -0.5], [0.5, 1, 0.5], [-0.5, 1, 0.5]]
FACES = np.array([[2, 1, 0], [3, 2, 0], [6, 5, 4], [7, 6, 4]], np.int32)


def write(folder, bad=()):
    """A square that moves along x over a floor, in four frames, a second apart. The frames in `bad` are unusable."""
    folder.mkdir(exist_ok=True)
    moments = np.array([FLOOR + [[x + k, y, z] for x, y, z in BLOCKER] for k in range(4)], np.float32)
    moments[list(bad), 5, 1] = np.nan
    np.save(folder / "frames.npy", moments)
    np.save(folder / "faces.npy", FACES)
    (folder / "info.json").write_text('{"times": [0.0, 1.0, 2.0, 3.0]}')
    return folder
