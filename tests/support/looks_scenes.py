"""Scenes whose pictures show everything that a store keeps of materials: maps, vertex colours, normals, holes."""

import numpy as np

import antumbra as at
from gltf_files import Gltf, png
from gltf_materials import ball, texture

CAMERA = at.Camera((0.5, 2.0, 7.0), (0.5, 0.3, 0.0), vfov=45, width=96, height=64)
LIGHTS = [at.QuadLight((-2, 5, 1), (2, 0, 0), (0, 0, 2), intensity=4.0), at.Sky()]


def _pixels(seed, n=16, channels=3):
    return np.random.default_rng(seed).integers(60, 256, (n, n, channels)).astype(np.uint8)


def _bumps(seed, n=16):
    x, y = np.random.default_rng(seed).normal(0, 0.2, (2, n, n))
    return np.rint(127.5 * (np.stack([x, y, np.sqrt(np.maximum(1 - x * x - y * y, 0.1))], -1) + 1)).clip(0, 255)


def gltf(folder, name):
    """A glossy ball with all maps, in two copies, one of them mirrored; leaves with holes; vertex colours; a floor."""
    made, rng = Gltf(), np.random.default_rng(3)
    points, uv, faces = ball(12)
    normal, bumps = {"NORMAL": made.accessor(points)}, texture(made, _bumps(1))
    turned = {"extensions": {"KHR_texture_transform": {"offset": [0.2, 0.1], "scale": [2, 3], "rotation": 0.4}}}
    made.add("samplers", wrapS=33648, wrapT=33071, magFilter=9728)
    base = texture(made, _pixels(2))
    made.json["textures"][base["index"]]["sampler"] = 0
    of_all = made.add(
        "materials", name="all", normalTexture=bumps | {"scale": 0.7},
        pbrMetallicRoughness={"baseColorTexture": base, "metallicRoughnessTexture": texture(made, _pixels(3)) | turned},
        occlusionTexture=texture(made, _pixels(4)) | {"strength": 0.6},
        emissiveTexture=texture(made, _pixels(5)) | {"texCoord": 1}, emissiveFactor=[0.1, 0.0, 0.2],
    )  # fmt: skip
    sets = {"TEXCOORD_0": made.accessor(2 * uv), "TEXCOORD_1": made.accessor(np.ascontiguousarray(3 * uv[:, ::-1]))}
    mesh = made.mesh(made.primitive(points, faces, attributes=normal | sets, material=of_all))
    made.node(mesh=mesh, translation=[-1.0, 0.5, 0.0], rotation=[0.0, 0.6, 0.0, 0.8])
    made.node(mesh=mesh, translation=[2.0, 0.5, -0.5], scale=[-0.8, 1.1, 0.8])
    holes = np.dstack([_pixels(6, 8), 255 * (rng.random((8, 8)) < 0.6).astype(np.uint8)])
    leaf = made.add("materials", alphaMode="MASK", pbrMetallicRoughness={"baseColorTexture": texture(made, holes)})
    square = np.float32([[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
    corners = {"TEXCOORD_0": made.accessor(np.float32([[0, 1], [1, 1], [1, 0], [0, 0]]))}
    quad = np.uint16([[0, 1, 2], [0, 2, 3]])
    made.node(mesh=made.mesh(made.primitive(square, quad, attributes=corners, material=leaf)), translation=[0.6, 0, 1])
    colours = {"COLOR_0": made.accessor(rng.random((len(points), 4)).astype(np.float32))}
    plain = made.add("materials", pbrMetallicRoughness={"baseColorFactor": [0.8, 0.7, 0.6, 1], "metallicFactor": 0.0})
    coloured = made.primitive((0.4 * points).astype(np.float32), faces, attributes=colours, material=plain)
    made.node(mesh=made.mesh(coloured), translation=[0.5, 0.0, 2.2])
    floor = (4 * np.float32([[-1, 0, 1], [1, 0, 1], [1, 0, -1], [-1, 0, -1]])).astype(np.float32)
    made.node(mesh=made.mesh(made.primitive(floor, quad)), translation=[0, -0.6, 0])
    (folder / name).write_bytes(made.glb())


def obj(folder, name):
    """A ball with a texture, smooth normals, and a second image for its opacity; and a floor."""
    points, uv, faces = ball(10)
    (folder / "bark.png").write_bytes(png(_pixels(7)))
    (folder / "holes.png").write_bytes(png(np.where(_pixels(8, 8) > 110, 255, 0)))
    (folder / "its.mtl").write_text("newmtl bark\nmap_Kd bark.png\nmap_d holes.png\nnewmtl floor\nKd 0.5 0.6 0.5\n")
    lines = ["mtllib its.mtl", "usemtl bark", *(f"v {x} {y} {z}" for x, y, z in points)]
    lines += [*(f"vt {u} {v}" for u, v in uv), *(f"vn {x} {y} {z}" for x, y, z in points)]
    lines += ["f " + " ".join(f"{k}/{k}/{k}" for k in face) for face in (faces + 1).tolist()]
    lines += ["usemtl floor", "v -3 -1 3", "v 3 -1 3", "v 3 -1 -3", "f -3 -2 -1"]
    (folder / name).write_text("\n".join(lines) + "\n")


FILES = {"a.glb": gltf, "a.obj": obj}


def scene_with_pixels():
    """A scene of arrays, whose texture is no encoded image."""
    points, uv, faces = ball(10)
    return at.Scene.from_arrays(points, faces, uv=uv, texture=_pixels(9), normals=points, name="pixels")
