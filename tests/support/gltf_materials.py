"""Scenes of a square or a ball with one glTF material, and glTF's formula for what it reflects, in NumPy."""

import numpy as np

import antumbra as at
from gltf_files import Gltf, png

SQUARE = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], np.float32)
SQUARE_FACES = np.array([[0, 1, 2], [0, 2, 3]], np.uint16)
SQUARE_UV = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
QUARTER = {"rotation": [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]}
DIRECT = {"ambient": False, "background": False, "antialias": False}
"""Options of a picture with direct light alone."""


def texture(made: Gltf, pixels) -> dict:
    """A reference to a texture of these pixels."""
    image = made.add("images", bufferView=made.view(png(np.asarray(pixels, np.uint8))), mimeType="image/png")
    return {"index": made.add("textures", source=image)}


def ball(n=32):
    """(positions, texture coordinates, faces) of a unit ball."""
    polar, around = np.meshgrid(np.linspace(0, np.pi, n + 1), np.linspace(0, 2 * np.pi, 2 * n + 1), indexing="ij")
    points = np.stack([np.sin(polar) * np.cos(around), np.cos(polar), np.sin(polar) * np.sin(around)], -1)
    i = (np.arange(n)[:, None] * (2 * n + 1) + np.arange(2 * n)).ravel()
    faces = np.concatenate([[i, i + 1, i + 2 * n + 1], [i + 1, i + 2 * n + 2, i + 2 * n + 1]], 1).T
    uv = np.stack([1 - around / (2 * np.pi), polar / np.pi], -1)
    return points.reshape(-1, 3).astype(np.float32), uv.reshape(-1, 2).astype(np.float32), faces.astype(np.uint32)


def square(
    folder,
    made=None,
    base=(1, 1, 1),
    metallic=0.0,
    roughness=1.0,
    node=None,
    tangent=None,
    model=None,
    second=None,
    **fields,
):
    """A square in the plane z = 0 with one material."""
    made = made or Gltf()
    model = {"baseColorFactor": [*base, 1], "metallicFactor": metallic, "roughnessFactor": roughness} | (model or {})
    material = made.add("materials", pbrMetallicRoughness=model, doubleSided=True, **fields)
    attributes = {
        "TEXCOORD_0": made.accessor(SQUARE_UV),
        "NORMAL": made.accessor(np.tile(np.float32([0, 0, 1]), (4, 1))),
    }
    if tangent is not None:
        attributes["TANGENT"] = made.accessor(np.tile(np.float32(tangent), (4, 1)))
    if second is not None:
        attributes["TEXCOORD_1"] = made.accessor(np.float32(second))
    mesh = made.mesh(made.primitive(SQUARE, SQUARE_FACES, attributes=attributes, material=material))
    made.node(mesh=mesh, **(node or {}))
    return at.load(made.write(folder))


def brdf(n, v, l, base, metallic, roughness, masking=None):
    """(..., 3): glTF 2.0, Appendix B.3, for unit vectors (..., 3); masking: None for Smith's correlated one."""
    base, alpha2 = np.asarray(base, np.float64), max(roughness**2, 0.002) ** 2
    h = (v + l) / np.linalg.norm(v + l, axis=-1, keepdims=True)
    nl, nv, nh, vh = (np.sum(a * b, -1) for a, b in ((n, l), (n, v), (n, h), (v, h)))
    d = alpha2 / (np.pi * (nh**2 * (alpha2 - 1) + 1) ** 2)
    if masking is None:
        masking = (
            2 * nl * nv / (nl * np.sqrt(alpha2 + (1 - alpha2) * nv**2) + nv * np.sqrt(alpha2 + (1 - alpha2) * nl**2))
        )
    schlick = (1 - np.abs(vh))[..., None] ** 5
    f0 = 0.04 * (1 - metallic) + base * metallic
    fresnel = f0 + (1 - f0) * schlick
    diffuse = base * (1 - metallic)
    return (1 - fresnel) * diffuse / np.pi + fresnel * (d * masking / (4 * nl * nv))[..., None]


def seen_points(scene, camera, frame):
    """(mask, points (k, 3), unit vectors to the eye (k, 3)) of the pixels that see a surface."""
    mask = frame.mask
    points = frame.gbuffer.position[mask].astype(np.float64) + frame.gbuffer.origin
    view = camera.position - points
    return mask, points, view / np.linalg.norm(view, axis=1, keepdims=True)
