"""Models of results: GLB files with the colours of their numbers, which the loader reads back."""

import json
import struct

import numpy as np
import pytest

import antumbra as at
from antumbra.city.tables.false_colours import ColouredMesh, coloured_glb
from antumbra.city.tables.result_table import Column, Table
from antumbra.formats.gltf.gltf_writer import LINES
from antumbra.picture.heat_maps import heat_colours
from antumbra.scene.materials import srgb_to_linear
from result_tables import table


def contents(data):
    """The JSON of a GLB file, and its arrays by accessor."""
    assert data[:4] == b"glTF" and struct.unpack_from("<I", data, 8)[0] == len(data)
    length = struct.unpack_from("<I", data, 12)[0]
    root, binary = json.loads(data[20 : 20 + length]), data[28 + length :]
    arrays = []
    for each in root["accessors"]:
        view, wide = root["bufferViews"][each["bufferView"]], {"VEC3": 3, "SCALAR": 1}[each["type"]]
        dtype = {5126: "<f4", 5125: "<u4"}[each["componentType"]]
        arrays.append(np.frombuffer(binary, dtype, each["count"] * wide, view.get("byteOffset", 0)).reshape(-1, wide))
    return root, arrays


def saved(made, folder, column=None):
    made.save(folder / "a.glb", column)
    return contents((folder / "a.glb").read_bytes())


def test_faces_have_the_colours_of_their_sensors(tmp_path):
    made = table()
    root, arrays = saved(made, tmp_path, "count")
    place = root["meshes"][0]["primitives"][0]["attributes"]
    colours = arrays[place["COLOR_0"]].reshape(4, 3, 3)
    wanted = srgb_to_linear(heat_colours(np.arange(-1, 3), 2.0) / 255.0)
    assert np.allclose(colours[made.sensors.faces[1:]], wanted[1:, None], atol=1e-6)
    assert np.allclose(colours[made.sensors.faces[0]], 0.35)  # -1 is no number
    assert root["asset"]["extras"]["column"] == "count" and root["asset"]["extras"]["job"] == "test"


@pytest.mark.parametrize("kind", ["face", "vertex", "grid", "raster", "points"])
def test_the_loader_reads_models_back_upright(tmp_path, kind):
    made = table(kind)
    saved(made, tmp_path)
    read = at.load(tmp_path / "a.glb")
    squares = 0 if kind in ("face", "vertex") else 2 * len(made)
    assert read.n_triangles == 4 + squares
    highest = read.triangles().vertices[:4].reshape(-1, 3) + read.origin
    assert np.isclose(highest[:, 1].max() - highest[:, 1].min(), 5.0)  # +Y is up in glTF


def test_squares_have_the_areas_of_sensors(tmp_path):
    made = table("grid")
    _, arrays = saved(made, tmp_path)
    corners = arrays[3].reshape(-1, 4, 3)
    u, v = corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0]
    across = np.cross(u, v)
    assert np.allclose(np.linalg.norm(across, axis=1), made.sensors.areas, rtol=1e-4)
    assert (np.einsum("ij,ij->i", across, made.sensors.normals) > 0).all()


@pytest.mark.parametrize("up", ["y", "z"])
def test_models_are_turned_exactly_and_points_are_level_squares(tmp_path, up):
    corners = np.array([[0, 0, 0], [0.3, 0, 0], [0, 0, -0.7]])
    corners = corners if up == "y" else corners[..., [0, 2, 1]] * (1, -1, 1)
    made = Table(
        at.point_sensors([[5, 5, 5]]), {"count": Column(np.ones(1), "", "")}, {}, at.Scene.from_arrays(corners, up=up)
    )
    saved(made, tmp_path)
    read = at.load(tmp_path / "a.glb").triangles()
    world = read.vertices.astype(float) + read.origin
    assert world[0, :, 1].tolist() == [0, 0, 0] and np.ptp(world[1:, :, 1]) == 0.0  # +Y is up in glTF


def test_lines():
    ends = np.array([[0, 0, 0], [1, 2, 3], [4, 5, 6], [7, 8, 9]], np.float32)
    part = ColouredMesh("lines", ends, np.ones((4, 3)), np.array([[0, 1], [2, 3]], np.uint32), LINES)
    root, arrays = contents(coloured_glb([part], at.Scene.from_arrays(ends[:3]), {}))
    use = root["meshes"][0]["primitives"][0]
    assert use["mode"] == 1 and arrays[use["indices"]].ravel().tolist() == [0, 1, 2, 3]
