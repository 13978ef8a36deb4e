"""The normals of vertices: every reader hands them to the bake, which measures with them and writes them."""

from types import SimpleNamespace

import numpy as np
import pytest

import antumbra as at
from antumbra.scene.appearance import normals_from_frames, normals_in_frames
from baked_files import Glb, grid, primitive
from gltf_files import Gltf

TURNS = {"upright": np.eye(3), "turned": np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])}


def pit(turn):
    """An open pit with hard edges: (vertices, faces, normals); vertices of an edge are split."""
    points, faces = grid(np.linspace(-2, 2, 5), np.linspace(-2, 2, 5))
    sides = [(points, (0.0, 1.0, 0.0))]
    for k in range(4):
        c, s = np.cos(k * np.pi / 2), np.sin(k * np.pi / 2)
        wall = np.stack([np.full(25, -2.0), points[:, 0] + 2.0, -points[:, 2]], 1)
        around = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
        sides.append((wall @ around.T, around @ (1.0, 0.0, 0.0)))
    vertices = np.concatenate([side for side, _ in sides]) @ turn.T
    normals = np.repeat([normal for _, normal in sides], 25, axis=0) @ turn.T
    every = np.concatenate([faces.astype(int) + 25 * k for k in range(5)])
    corners = vertices[every]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    flipped = (facing * normals[every[:, 0]]).sum(1) < 0.0
    every[flipped] = every[flipped][:, ::-1]
    return np.round(vertices, 6), every, np.round(normals, 6)


def write_gltf(folder, vertices, faces, normals):
    made = Gltf()
    rows = vertices.astype(np.float32), faces.astype(np.uint32)
    made.node(mesh=made.mesh(primitive(made, *rows, NORMAL=normals.astype(np.float32))))
    return made.write(folder, "pit.glb")


def write_obj(folder, vertices, faces, normals):
    lines = ["v {} {} {}".format(*row) for row in vertices] + ["vn {} {} {}".format(*row) for row in normals]
    lines += ["f " + " ".join(f"{k + 1}//{k + 1}" for k in face) for face in faces.tolist()]
    (folder / "pit.obj").write_text("\n".join(lines) + "\n")
    return folder / "pit.obj"


def write_ply(folder, vertices, faces, normals, binary=False, coloured=False):
    names = [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
    kind = "binary_little_endian" if binary else "ascii"
    head = ["ply", f"format {kind} 1.0", f"element vertex {len(vertices)}", *names]
    channels = ("red", "green", "blue") if coloured else ()
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    head += [*(f"property uchar {channel}" for channel in channels), "end_header\n"]
    rows = np.hstack([vertices, normals]).astype("<f4")
    table = np.zeros(len(faces), [("n", "u1"), ("corners", "<i4", 3), *((channel, "u1") for channel in channels)])
    table["n"], table["corners"] = 3, faces
    lines = [" ".join(map(str, row)) for row in rows.tolist()] + ["3 {} {} {}".format(*face) for face in faces]
    body = rows.tobytes() + table.tobytes() if binary else "\n".join(lines).encode()
    (folder / "pit.ply").write_bytes("\n".join(head).encode() + body)
    return folder / "pit.ply"


def moved(folder, vertices, faces, normals):
    """The scene at another place, moved to the right one."""
    quarter = np.array([[0.0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 0, 1]])
    scene = at.Scene.from_arrays(vertices @ quarter[:3, :3], faces, normals=normals @ quarter[:3, :3])
    scene.update(objects="*", transform=quarter)
    return scene


def open3d_mesh(_, vertices, faces, normals):
    """An object that looks like a mesh of Open3D."""
    return SimpleNamespace(
        vertices=vertices,
        triangles=faces,
        vertex_normals=normals,
        has_vertex_normals=lambda: True,
        has_vertex_colors=lambda: False,
    )


def pyvista_mesh(_, vertices, faces, normals):
    """An object that looks like a mesh of PyVista."""
    rows = np.column_stack([np.full(len(faces), 3), faces]).reshape(-1)
    made = SimpleNamespace(points=vertices, faces=rows, n_cells=len(faces), strips=None)
    made.point_data, made.cell_data = {"Normals": normals}, {}
    made.triangulate = made.extract_surface = lambda: made
    return made


READERS = {
    "gltf": write_gltf,
    "gltf scene": lambda *pit: at.load(write_gltf(*pit), up="y"),
    "obj": write_obj,
    "ply": write_ply,
    "binary ply": lambda *pit: write_ply(*pit, binary=True),
    "coloured ply": lambda *pit: write_ply(*pit, binary=True, coloured=True),
    "coloured arrays": lambda _, vertices, faces, normals: at.Scene.from_arrays(
        vertices, faces, np.full((len(faces), 3), 0.5), normals=normals
    ),
    "open3d": open3d_mesh,
    "pyvista": pyvista_mesh,
    "arrays": lambda _, vertices, faces, normals: at.Scene.from_arrays(vertices, faces, normals=normals),
    "moved": moved,
}


def values_at(path, points, normals, name="_AO"):
    """Values of a baked file at points with these normals, whatever the order of its vertices; and its normals."""
    made, file = at.load(path, up="y"), Glb(path)
    shown = [i for i, node in enumerate(file.json["nodes"]) if "mesh" in node]
    rows = {key: np.concatenate([file.attribute(key, i) for i in shown]) for key in ("POSITION", "NORMAL", name)}
    places = rows["POSITION"] + (made.bounds[0] - rows["POSITION"].min(0))
    apart = np.abs(places[None] - points[:, None]).max(2) + np.abs(rows["NORMAL"][None] - normals[:, None]).max(2)
    nearest = apart.argmin(1)
    assert apart[np.arange(len(points)), nearest].max() < 1e-5
    return rows[name][nearest, 0]


@pytest.mark.parametrize("turn", TURNS.values(), ids=TURNS)
@pytest.mark.parametrize("reader", READERS)
def test_a_bake_uses_and_writes_the_normals_of_every_reader(tmp_path, reader, turn):
    vertices, faces, normals = pit(turn)
    source = READERS[reader](tmp_path, vertices, faces, normals)
    at.bake(source, tmp_path / "out.glb", spp=1024, attribute="_AO", up="y")
    found = values_at(tmp_path / "out.glb", vertices, normals)
    scene = at.Scene.from_arrays(vertices, faces)
    expected = at.visibility(scene, vertices, at.AmbientOcclusion(), normals, spp=1024).fraction
    assert np.ptp(expected) > 0.5 and len(found) == 125
    error = found - expected  # of two independent sets of 1024 rays
    assert np.sqrt((error**2).mean()) < 5e-3 and abs(error.mean()) < 1e-3 and np.abs(error).max() < 0.02
    at.bake(write_gltf(tmp_path, vertices, faces, normals), tmp_path / "peer.glb", spp=1024, attribute="_AO", up="y")
    if reader != "moved":  # whose float32 vertices and normals are those of another place
        np.testing.assert_array_equal(found, values_at(tmp_path / "peer.glb", vertices, normals))


@pytest.mark.parametrize("reader", ["obj", "ply", "arrays"])
def test_a_texture_keeps_the_normals(tmp_path, reader):
    pytest.importorskip("xatlas")
    source = READERS[reader](tmp_path, *pit(np.eye(3)))
    at.bake(source, tmp_path / "out.glb", texture=32, spp=16)
    file = Glb(tmp_path / "out.glb")
    (made,) = (mesh["primitives"][0] for mesh in file.json["meshes"])
    assert set(made["attributes"]) == {"NORMAL", "POSITION", "TEXCOORD_0"}


def test_faces_without_normals_are_written_without(tmp_path):
    """Two squares in one mesh; the normals of the second are zero, as some exporters write them."""
    points, faces = grid([0.0, 1.0], [0.0, 1.0])
    vertices = np.concatenate([points, points + np.float32(3.0)])
    normals = np.repeat([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0]], 4, axis=0)
    scene = at.Scene.from_arrays(vertices, np.concatenate([faces, faces + 4]), normals=normals)
    at.bake(scene, tmp_path / "out.glb", spp=16)
    file = Glb(tmp_path / "out.glb")
    node = next(i for i, node in enumerate(file.json["nodes"]) if "mesh" in node)
    primitives = [file.primitive(node, k)["attributes"] for k in (0, 1)]
    assert "NORMAL" in primitives[0] and "NORMAL" not in primitives[1]
    np.testing.assert_array_equal(file.attribute("NORMAL", node), np.tile([0.0, 1.0, 0.0], (4, 1)))


def test_normals_come_back_from_the_frames_of_moved_triangles():
    rng = np.random.default_rng(8)
    corners, normals = rng.normal(size=(40, 3, 3)), rng.normal(size=(40, 3, 3))
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    unit = normals / np.linalg.norm(normals, axis=-1, keepdims=True)
    found = normals_from_frames(2.5 * corners @ turn.T + 7.0, normals_in_frames(corners, normals))
    np.testing.assert_allclose(found, unit @ turn.T, atol=1e-3)
    flat = np.zeros((1, 3, 3))
    assert not normals_from_frames(corners[:1], flat).any() and not normals_from_frames(flat, flat + 1.0).any()
