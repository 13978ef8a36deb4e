"""Scenes of the package for JavaScript in node, to which tests put questions."""

import json
import shutil
import subprocess
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

NODE = shutil.which("node")
without_node = pytest.mark.skipif(
    NODE is None or find_spec("ziglang") is None, reason="without node and ziglang, the package is NOT checked"
)
ASK = Path(__file__).parents[1] / "web" / "ask.mjs"
HITS = {"face": np.int32, "t": np.float64, "u": np.float32, "v": np.float32}
TYPES = {
    "occluded": {"blocked": np.uint8},
    "closestHit": HITS,
    "sunHours": {"hours": np.float64},
    "visibility": {"fraction": np.float32, "bits": np.uint64, "seenSamples": np.uint8},
}


class Asked:
    """A scene in node, and questions for it."""

    def __init__(self, package, folder, positions, indices=None):
        self.package, self.folder, self.files, self.questions = package, folder, 0, []
        self.scene = {"positions": self._file(positions), "indices": self._file(indices)}

    def _file(self, value):
        if not isinstance(value, np.ndarray):
            return value
        self.files += 1
        np.ascontiguousarray(value).tofile(self.folder / f"in{self.files}")
        return {"file": f"in{self.files}", "dtype": value.dtype.str}

    def ask(self, method, *values, **options):
        files = {name: self._file(value) for name, value in options.items()}
        self.questions.append({"method": method, "values": [*map(self._file, values)], "options": files})

    def answers(self):
        """For each question: an error's message, or its arrays by name."""
        (self.folder / "questions.json").write_text(json.dumps({"scene": self.scene, "questions": self.questions}))
        subprocess.run([NODE, ASK, self.package, self.folder], check=True)
        answers = json.loads((self.folder / "answers.json").read_text())
        return [answer.get("error") or self._arrays(k) for k, answer in enumerate(answers)]

    def _arrays(self, k):
        types = TYPES[self.questions[k]["method"]]
        return {name: np.fromfile(self.folder / f"{k}-{name}", dtype) for name, dtype in types.items()}


def grid(n=6):
    """Two layers of squares whose corners and edges rays meet, with coinciding and degenerate triangles."""
    x, z = np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0))
    layer = np.stack([x.ravel(), np.zeros(x.size), z.ravel()], 1)
    vertices = np.concatenate([layer, layer + [0.0, 1.5, 0.0]])
    at_corner = [row * (n + 1) + column for row in range(n) for column in range(n)]
    faces = [(i, i + 1, i + n + 2) for i in at_corner] + [(i, i + n + 2, i + n + 1) for i in at_corner]
    faces += [(a + len(layer), b + len(layer), c + len(layer)) for a, b, c in faces[::3]]
    faces[5:5] = [(0, 1, 2), (3, 3, 3), faces[0]]  # a line, a point, and a copy
    return vertices.astype(np.float32), np.array(faces, np.int32)


def soup(n=3000, seed=3):
    generator = np.random.default_rng(seed)
    corners = generator.normal(size=(n, 1, 3)) * 5 + generator.normal(size=(n, 3, 3)) * generator.exponential(
        1, (n, 1, 1)
    )
    return corners.reshape(-1, 3).astype(np.float32), None


MESHES = {
    "grid": grid(),
    "soup": soup(),
    "far away": (soup(500)[0] + np.float32([2e5, 0, -3e4]), None),
    "one triangle": (np.float32([[0, 0, 0], [2, 0, 0], [0, 0, 2]]), None),
    "no area": (np.float32([[0, 0, 0], [1, 0, 0], [2, 0, 0]]), None),
}
