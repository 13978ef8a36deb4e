"""The stand-in as a glTF file whose colours the browser shows as they are."""

import numpy as np

from ..formats.gltf.gltf_file import ARRAY_BUFFER, FLOAT, buffer_views, glb_bytes

# three.js maps the tones of all materials by a fit of ACES, and viser leaves that on. These are its constants.
_INTO = np.array([[0.59719, 0.35458, 0.04823], [0.07600, 0.90834, 0.01566], [0.02840, 0.13383, 0.83777]])
_OUT = np.array([[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]])
_DARKER = 0.6


def glb_of(corners: np.ndarray, colours: np.ndarray) -> bytes:
    """A GLB file of triangles, each seen from its two sides in the colours of these.

    corners : (n, 3, 3) float32, at least one
    colours : (2, n, 3) float32, linear, in [0, 1]: of the front and of the back
    """
    both = np.concatenate([corners, corners[:, ::-1]]).reshape(-1, 3).astype(np.float32)
    shown = np.repeat(before_aces(colours).reshape(-1, 3), 3, axis=0).astype(np.float32)
    root = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "extensionsUsed": ["KHR_materials_unlit"],
        "materials": [{"extensions": {"KHR_materials_unlit": {}}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "COLOR_0": 1}, "material": 0}]}],
        "accessors": [
            {**_accessor(0, both), "min": both.min(0).tolist(), "max": both.max(0).tolist()},
            _accessor(1, shown),
        ],
        **buffer_views([both, shown], [ARRAY_BUFFER, ARRAY_BUFFER]),
    }
    return glb_bytes(root, [both, shown])


def before_aces(colours: np.ndarray) -> np.ndarray:
    """(..., 3) float64: the linear colours that three.js maps to these; the inverse of its ACES curve."""
    y = np.clip(np.asarray(colours, np.float64) @ np.linalg.inv(_OUT).T, 0.0, 0.99)
    # y = (x (x + p) - q) / (x (r x + s) + t), solved for x
    p, q, r, s, t = 0.0245786, 0.000090537, 0.983729, 0.4329510, 0.238081
    a, b, c = 1.0 - r * y, p - s * y, -q - t * y
    x = (-b + np.sqrt(b * b - 4.0 * a * c)) / (2.0 * a)
    return np.maximum(x @ np.linalg.inv(_INTO).T, 0.0) * _DARKER


def _accessor(view: int, array: np.ndarray) -> dict:
    return {"bufferView": view, "componentType": FLOAT, "count": len(array), "type": "VEC3"}
