"""Coordinates that float32 has rounded in files are noted; those that it holds exactly are not."""

import warnings

import numpy as np
import pytest

import antumbra as at
from antumbra.city.sensors.sensor_files import read_points
from gltf_files import Gltf

UTM = np.array([5e5, 5.8e6, 30.0])
ROOF = np.array([[0, 0, 0], [12.3, 0, 0.1], [12.4, 8.7, 0.3], [0.1, 8.9, 0.2], [6.2, 4.4, 3.3]])
FACES = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])


def write(path, points):
    """A small roof in a file whose coordinates are float32, except in .obj and text."""
    corners = points[FACES].astype("<f4")
    if path.suffix == ".stl":
        facets = np.zeros(len(FACES), np.dtype([("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")]))
        facets["c"] = corners
        path.write_bytes(bytes(80) + np.uint32(len(FACES)).tobytes() + facets.tobytes())
    elif path.suffix == ".ply":
        head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
        head += "".join(f"property float {axis}\n" for axis in "xyz")
        head += f"element face {len(FACES)}\nproperty list uchar int vertex_indices\nend_header\n"
        faces = np.zeros(len(FACES), [("n", "u1"), ("c", "<i4", 3)])
        faces["n"], faces["c"] = 3, FACES
        path.write_bytes(head.encode() + points.astype("<f4").tobytes() + faces.tobytes())
    elif path.suffix == ".glb":
        made = Gltf()
        made.node(mesh=made.mesh(made.primitive(points.astype(np.float32), FACES.astype(np.uint16))))
        made.write(path.parent, path.name)
    elif path.suffix == ".obj":
        lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()] + [f"f {a} {b} {c}" for a, b, c in FACES + 1]
        path.write_text("\n".join(lines) + "\n")
    else:
        path.mkdir()
        np.save(path / "frames.npy", points[None].astype(np.float32))
        np.save(path / "faces.npy", FACES.astype(np.int32))
    return path


@pytest.mark.parametrize("name", ["a.stl", "a.ply", "a.glb", "a"])
def test_map_coordinates_in_float32_files_are_noted(name, tmp_path):
    with pytest.warns(
        UserWarning, match=rf"^{name}: its coordinates, up to 5800\d+, were rounded to steps of 0.5 by float32"
    ):
        scene = at.load(write(tmp_path / name, UTM + ROOF))
    assert any("export it in float64, or nearer to the origin" in note for note in scene.notes)


@pytest.mark.parametrize(
    "points",
    [
        pytest.param(ROOF, id="near the origin"),
        pytest.param(UTM + np.round(ROOF / 4.0) * 4.0, id="whole multiples of the steps"),
        pytest.param(UTM * [1, 1, 0] + 1e5 * ROOF, id="a large scene"),
    ],
)
@pytest.mark.parametrize("name", ["a.stl", "a.ply", "a.glb", "a"])
def test_other_coordinates_are_not(name, points, tmp_path):
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message=".*rounded")
        at.load(write(tmp_path / name, points))


def test_text_has_all_digits_unless_float32_wrote_it(tmp_path):
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message=".*rounded")
        at.load(write(tmp_path / "a.obj", UTM + ROOF))
    with pytest.warns(UserWarning, match="rounded to steps of 0.5"):
        at.load(write(tmp_path / "a.obj", (UTM + ROOF).astype(np.float32).astype(np.float64)))


@pytest.mark.parametrize("suffix", [".npy", ".npz"])
def test_points_of_sensors_likewise(suffix, tmp_path):
    points = (UTM + 10.0 * np.random.default_rng(0).random((50, 3))).astype(np.float32)
    path, save = tmp_path / f"a{suffix}", {".npy": np.save, ".npz": lambda p, a: np.savez(p, **dict(zip("xyz", a.T)))}
    save[suffix](path, points)
    with pytest.warns(UserWarning, match=r"rounded to steps of 0.5 by float32; write it in float64"):
        read_points(path)
    save[suffix](path, points.astype(np.float64) + 0.123)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        read_points(path)
