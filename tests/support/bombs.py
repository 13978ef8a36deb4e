"""Bombs: small files that a reader may take long over, or expand to far more than their size.

`BOMBS` has a generator of each. It writes a file of less than a megabyte into a folder and returns a call that reads it
to the end. To add one, decorate a generator with `bomb`; its test is parametrised over the dict.
"""

import io
import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np

import antumbra as at
import city_files
from gltf_files import Gltf

Reader = Callable[[], object]
BOMBS = dict[str, Callable[[Path], Reader]]()
MAX_BYTES = 1 << 20  # of all files of a bomb


def bomb(name: str):
    """Add a generator to `BOMBS`, as "reader: what it does"."""

    def add(make: Callable[[Path], Reader]):
        assert name not in BOMBS and ": " in name
        BOMBS[name] = make
        return make

    return add


def loaded(path: Path) -> Reader:
    """Read a scene with its triangles, colours and textures."""

    def read() -> object:
        scene = at.load(path)
        return scene.triangles().colour, scene.data.cutouts, scene.object_of_face[:1], scene.bounds

    return read


def written(path: Path, data: bytes | str) -> Reader:
    path.write_bytes(data.encode() if isinstance(data, str) else data)
    return loaded(path)


# --- CityJSON ---------------------------------------------------------------------------------------------------------


def city(folder: Path, polygons, vertices, **more) -> Reader:
    """A city of one object; polygons are lists of rings."""
    objects = {"a": city_files.building(city_files.surfaces(boundaries=polygons))}
    document = city_files.city(objects, vertices, **more)
    return written(folder / "a.city.json", json.dumps(document, separators=(",", ":")))


SQUARE = [[0, 0, 0], [9, 0, 0], [9, 9, 0], [0, 9, 0], [5, 5, 0]]


@bomb("CityJSON: a corner repeated")
def _(folder):
    return city(folder, [[[0] * 300_000 + [1, 2, 3]]], SQUARE)


@bomb("CityJSON: two corners in turn")
def _(folder):
    return city(folder, [[[0, 1] * 100_000 + [2, 3]]], SQUARE)


@bomb("CityJSON: a square walked around many times")
def _(folder):
    return city(folder, [[[0, 1, 2, 3] * 60_000]], SQUARE)


@bomb("CityJSON: a spike walked up and down between the corners of a square")
def _(folder):
    return city(folder, [[[0, 4, 1, 4, 2, 4, 3, 4] * 30_000 + [0, 1, 2, 3]]], SQUARE)


@bomb("CityJSON: a star of many corners in a random order")
def _(folder):
    rng = np.random.default_rng(0)
    return city(folder, [[list(range(40_000))]], rng.integers(0, 10_000, (40_000, 3)) * [1, 1, 0])


@bomb("CityJSON: a comb of many teeth")
def _(folder):
    n = 15_000
    teeth = [[k, 9999 * (k % 2), 0] for k in range(2 * n)]
    return city(folder, [[list(range(2 * n + 2))]], [*teeth, [2 * n, -9, 0], [-1, -9, 0]])


@bomb("CityJSON: many holes")
def _(folder):
    cells = np.stack(np.meshgrid(np.arange(100), np.arange(100)), -1).reshape(-1, 1, 2) * 10
    corners = (cells + [[1, 1], [1, 5], [5, 1]]).reshape(-1, 2)
    around = [[-9, -9], [2000, -9], [2000, 2000], [-9, 2000]]
    vertices = np.pad(np.concatenate([around, corners]), ((0, 0), (0, 1)))
    holes = (np.arange(len(corners)) + 4).reshape(-1, 3).tolist()
    return city(folder, [[[0, 1, 2, 3], *holes]], vertices)


@bomb("CityJSON: one hole repeated")
def _(folder):
    return city(folder, [[[0, 1, 2, 3], *[[4, 5, 6]] * 100_000]], [*SQUARE[:4], [2, 2, 0], [2, 3, 0], [3, 2, 0]])


@bomb("CityJSON: many instances of a template of many triangles")
def _(folder):
    shape = city_files.surfaces(boundaries=[[[0, 1, 2]]] * 20_000)
    matrix = np.eye(4).reshape(-1).tolist()
    place = {"type": "GeometryInstance", "template": 0, "boundaries": [0], "transformationMatrix": matrix}
    objects = {"a": {"type": "CityFurniture", "geometry": [place] * 4_000}}
    more = {"geometry-templates": {"templates": [shape], "vertices-templates": SQUARE}}
    return written(folder / "a.city.json", json.dumps(city_files.city(objects, SQUARE, **more), separators=(",", ":")))


@bomb("CityJSON: a chain of objects within one another")
def _(folder):
    objects = {
        f"{k}": {"type": "BuildingPart", "parents": [f"{k - 1}"], "attributes": {f"a{k}": k},
                 "geometry": [city_files.surfaces(boundaries=[[[0, 1, 2]]])]}
        for k in range(6_000)
    }  # fmt: skip
    return written(folder / "a.city.json", json.dumps(city_files.city(objects, SQUARE), separators=(",", ":")))


@bomb("CityJSON: objects that all name all others")
def _(folder):
    names = [f"{k}" for k in range(250)]
    part = {"type": "BuildingPart", "parents": names, "children": names}
    objects = {name: part | {"geometry": [city_files.surfaces(boundaries=[[[0, 1, 2]]])]} for name in names}
    return written(folder / "a.city.json", json.dumps(city_files.city(objects, SQUARE), separators=(",", ":")))


@bomb("CityJSON: lists nested without end")
def _(folder):
    return written(folder / "a.city.json", '{"type":"CityJSON","vertices":' + "[" * 500_000)


@bomb("CityJSONSeq: a line for each vertex")
def _(folder):
    head = city_files.city({}, np.zeros((0, 3)))
    lines = [json.dumps(head)] + ['{"type":"CityJSONFeature","CityObjects":{},"vertices":[]}'] * 15_000
    return written(folder / "a.city.jsonl", "\n".join(lines))


# --- PLY and STL ------------------------------------------------------------------------------------------------------

PLY = "ply\nformat {} 1.0\nelement vertex {}\n{}element face {}\n{}end_header\n"
XYZ, INDICES = "".join(f"property float {axis}\n" for axis in "xyz"), "property list uchar int vertex_indices\n"
CORNERS = struct.pack("<9f", 0, 0, 0, 1, 0, 0, 0, 1, 0)
ONE = struct.pack("<B3i", 3, 0, 1, 2)
BINARY = "binary_little_endian"


@bomb("PLY: many properties")
def _(folder):
    more = "".join(f"property char a{k}\n" for k in range(40_000))
    body = b"".join(struct.pack("<3f", *corner) + bytes(40_000) for corner in ((0, 0, 0), (1, 0, 0), (0, 1, 0)))
    return written(folder / "a.ply", PLY.format(BINARY, 3, XYZ + more, 1, INDICES).encode() + body + ONE)


@bomb("PLY: many properties of text")
def _(folder):
    more = "".join(f"property char a{k}\n" for k in range(30_000))
    body = "".join(f"{corner} {'0 ' * 30_000}\n" for corner in ("0 0 0", "1 0 0", "0 1 0"))
    return written(folder / "a.ply", PLY.format("ascii", 3, XYZ + more, 1, INDICES) + body + "3 0 1 2\n")


@bomb("PLY: many lists in each vertex")
def _(folder):
    more = "".join(f"property list uchar int a{k}\n" for k in range(20_000))
    body = b"".join(struct.pack("<3f", *corner) + bytes(20_000) for corner in ((0, 0, 0), (1, 0, 0), (0, 1, 0)))
    return written(folder / "a.ply", PLY.format(BINARY, 3, XYZ + more, 1, INDICES).encode() + body + ONE)


@bomb("PLY: a list in each of many vertices")
def _(folder):
    more, n = "property list uchar int a\n", 70_000
    body = np.zeros((n, 13), np.uint8).tobytes()
    return written(folder / "a.ply", PLY.format(BINARY, n, XYZ + more, 1, INDICES).encode() + body + ONE)


@bomb("PLY: as many lists as are read, in each of many vertices")
def _(folder):
    more = "".join(f"property list uchar int a{k}\n" for k in range(990))
    body = np.zeros((300, 12 + 990), np.uint8).tobytes()
    return written(folder / "a.ply", PLY.format(BINARY, 300, XYZ + more, 1, INDICES).encode() + body + ONE)


@bomb("PLY: many elements")
def _(folder):
    more = "".join(f"element e{k} 1\nproperty char a\n" for k in range(20_000))
    head = PLY.format(BINARY, 3, XYZ, 1, INDICES + more).encode()
    return written(folder / "a.ply", head + CORNERS + ONE + bytes(20_000))


@bomb("PLY: vertices without properties")
def _(folder):
    return written(folder / "a.ply", PLY.format(BINARY, 900_000, "", 1, INDICES).encode() + bytes(900_000))


@bomb("PLY: more vertices than bytes")
def _(folder):
    return written(folder / "a.ply", PLY.format(BINARY, 2**62, XYZ, 2**62, INDICES).encode() + bytes(1000))


@bomb("PLY: a face of many corners")
def _(folder):
    head = PLY.format(BINARY, 3, XYZ, 1, "property list int int vertex_indices\n").encode()
    return written(folder / "a.ply", head + CORNERS + struct.pack("<i", 240_000) + bytes(960_000))


@bomb("PLY: a face of a negative number of corners")
def _(folder):
    head = PLY.format(BINARY, 3, XYZ, 2, "property list int int vertex_indices\n").encode()
    return written(folder / "a.ply", head + CORNERS + struct.pack("<i", -(2**31)) + bytes(1000))


@bomb("PLY: a face that takes most of what there is not")
def _(folder):
    head = PLY.format(BINARY, 3, XYZ, 1, "property list uint int vertex_indices\n").encode()
    return written(folder / "a.ply", head + CORNERS + struct.pack("<I", 2**32 - 1) + bytes(1000))


@bomb("PLY: many comments")
def _(folder):
    return written(folder / "a.ply", "ply\n" + "comment\n" * 120_000 + PLY.format("ascii", 3, XYZ, 1, INDICES)[4:])


@bomb("PLY: polygons of many sizes")
def _(folder):
    rng, head = np.random.default_rng(0), PLY.format(BINARY, 300, XYZ, 4_000, INDICES).encode()
    faces = b"".join(bytes([n]) + rng.integers(0, 300, n).astype("<i4").tobytes() for n in rng.integers(3, 100, 4_000))
    return written(folder / "a.ply", head + rng.random((300, 3)).astype("<f4").tobytes() + faces)


@bomb("STL: solids that do not end")
def _(folder):
    return written(folder / "a.stl", "solid a facet\n" * 70_000)


@bomb("STL: many empty solids")
def _(folder):
    return written(folder / "a.stl", "solid facet\nendsolid\n" * 45_000)


@bomb("STL: many solids of one name")
def _(folder):
    facet = "facet normal 0 0 0\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n"
    return written(folder / "a.stl", f"solid a\n{facet}endsolid\n" * 8_000)


@bomb("STL: spaces before what is no solid")
def _(folder):
    return written(folder / "a.stl", "solid facet\n" + " \t" * 500_000)


@bomb("STL: more facets than bytes")
def _(folder):
    return written(folder / "a.stl", bytes(80) + struct.pack("<I", 2**32 - 1) + bytes(1000))


# --- OBJ and MTL ------------------------------------------------------------------------------------------------------

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


@bomb("OBJ: a face of many corners")
def _(folder):
    return written(folder / "a.obj", TRIANGLE + "f " + "1 2 3 " * 160_000)


@bomb("OBJ: lines that go on")
def _(folder):
    return written(folder / "a.obj", TRIANGLE + "f \\\n1 \\\n2 \\\n3\n" * 60_000 + "f 1 2 3 \\\n" * 10_000)


@bomb("OBJ: many objects and groups")
def _(folder):
    return written(folder / "a.obj", TRIANGLE + "o a\ng a\nf 1 2 3\n" * 50_000)


@bomb("OBJ: many libraries")
def _(folder):
    return written(folder / "a.obj", "".join(f"mtllib {k}\n" for k in range(20_000)) + TRIANGLE)


@bomb("OBJ: far indices")
def _(folder):
    return written(folder / "a.obj", TRIANGLE + f"f {2**62} {2**62} {2**62}\nf -{2**62} 1 2\n" * 10_000)


@bomb("OBJ: slashes")
def _(folder):
    return written(folder / "a.obj", TRIANGLE + "f " + "/" * 900_000)


@bomb("OBJ: spaces")
def _(folder):
    return written(folder / "a.obj", TRIANGLE + "f" + " " * 900_000 + "1 2 3\n")


@bomb("OBJ: long numbers")
def _(folder):
    return written(folder / "a.obj", TRIANGLE + "v " + "9" * 900_000 + " 0 0\n")


def with_materials(folder: Path, materials: str, head: str = "") -> Reader:
    (folder / "a.mtl").write_text(materials)
    return written(folder / "a.obj", "mtllib a.mtl\n" + head + TRIANGLE)


@bomb("MTL: many materials")
def _(folder):
    return with_materials(folder, "".join(f"newmtl m{k}\nKd 1 0 0\n" for k in range(40_000)))


@bomb("MTL: many missing textures")
def _(folder):
    return with_materials(folder, "".join(f"newmtl m{k}\nmap_Kd {k}.png\n" for k in range(25_000)))


@bomb("MTL: options of options of a texture")
def _(folder):
    return with_materials(
        folder, "newmtl a\nmap_Kd " + "-s " * 40 + "\nmap_d " + "-o -s -t " * 100_000 + "\n", "usemtl a\n"
    )


@bomb("MTL: many textures of one picture")
def _(folder):
    (folder / "a.png").write_bytes(png(1000))
    names = (f"newmtl m{k}\nmap_Kd {'./' * (k % 300)}a.png\nmap_d {'./' * (k // 300)}a.png\n" for k in range(1500))
    return with_materials(folder, "".join(names))


# --- glTF and pictures ------------------------------------------------------------------------------------------------


def png(size: int, height: int | None = None, data: bytes | None = None) -> bytes:
    """A black picture, or one with other compressed data."""
    height = size if height is None else height
    rows = zlib.compress(bytes((size + 1) * height), 9) if data is None else data

    def chunk(kind: bytes, content: bytes) -> bytes:
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    head = struct.pack(">IIBBBBB", size, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


def with_picture(folder: Path, picture: bytes, copies: int = 1) -> Reader:
    """A triangle with textures whose alpha cuts it."""
    made = Gltf()
    uv = made.accessor(np.array([[0, 0], [1, 0], [0, 1]], np.float32))
    view = made.view(picture)
    for _ in range(copies):
        texture = made.add("textures", source=made.add("images", bufferView=view))
        look = {"baseColorTexture": {"index": texture}}
        material = made.add("materials", alphaMode="MASK", pbrMetallicRoughness=look)
        made.node(mesh=made.mesh(made.primitive(attributes={"TEXCOORD_0": uv}, material=material)))
    return written(folder / "a.glb", made.glb())


@bomb("picture: a PNG of many pixels")
def _(folder):
    return with_picture(folder, png(14_000))


@bomb("picture: a PNG that declares many pixels")
def _(folder):
    return with_picture(folder, png(2**30, 2**30, b""))


@bomb("picture: many textures of one PNG")
def _(folder):
    return with_picture(folder, png(2_000), 900)


@bomb("picture: a PNG with text that expands")
def _(folder):
    text = b"a\0\0" + zlib.compress(bytes(500_000_000), 9)
    extra = struct.pack(">I", len(text)) + b"zTXt" + text + struct.pack(">I", zlib.crc32(b"zTXt" + text))
    plain = png(8)
    return with_picture(folder, plain[:33] + extra + plain[33:])


@bomb("picture: KTX2 that declares many pixels")
def _(folder):
    from repository import ROOT

    data = bytearray((ROOT / "tests/data/compressed/leaf-uastc.ktx2").read_bytes())
    data[20:28] = struct.pack("<II", 1 << 16, 1 << 16)
    return with_picture(folder, bytes(data))


@bomb("glTF: many nodes of one mesh")
def _(folder):
    made = Gltf()
    mesh = made.mesh(made.primitive())
    for _ in range(15_000):
        made.node(mesh=mesh)
    return written(folder / "a.glb", made.glb())


@bomb("glTF: many views of one picture")
def _(folder):
    return with_picture(folder, png(64), 2_000)


# --- Arrays -----------------------------------------------------------------------------------------------------------


def npy(shape, data: bytes = b"") -> bytes:
    stream = io.BytesIO()
    np.lib.format.write_array_header_1_0(stream, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return stream.getvalue() + data


@bomb("frames: an array that declares many numbers")
def _(folder):
    (folder / "frames.npy").write_bytes(npy((2**40, 3, 3)))
    np.save(folder / "faces.npy", np.array([[0, 1, 2]]))
    return loaded(folder)


@bomb("frames: many moments of few vertices")
def _(folder):
    np.save(folder / "frames.npy", np.zeros((10_000, 3, 3), np.float32))
    np.save(folder / "faces.npy", np.zeros((20_000, 3), np.int32))
    return loaded(folder)


@bomb("frames: a header nested without end")
def _(folder):
    (folder / "frames.npy").write_bytes(b"\x93NUMPY\x02\x00" + struct.pack("<I", 500_000) + b"(" * 500_000)
    np.save(folder / "faces.npy", np.array([[0, 1, 2]]))
    return loaded(folder)


# --- Tables -----------------------------------------------------------------------------------------------------------

SCENE = at.Scene.from_arrays(np.array([[[0.0, 0, 0], [1, 0, 0], [0, 1, 0]]]), up="z")


@bomb("sensors: a row of many columns")
def _(folder):
    columns = 100_000
    path = folder / "a.csv"
    path.write_text("x,y,z," + ",".join(f"a{k}" for k in range(columns)) + "\n" + "0," * (columns + 2) + "0\n")
    return lambda: at.sensors_of(str(path), SCENE)


@bomb("sensors: a quotation without end")
def _(folder):
    path = folder / "a.csv"
    path.write_text('x,y,z\n0,0,"' + "0,0,0\n" * 150_000)
    return lambda: at.sensors_of(str(path), SCENE)


@bomb("sensors: an array that declares many numbers")
def _(folder):
    path = folder / "a.npy"
    path.write_bytes(npy((2**40, 3)))
    return lambda: at.sensors_of(str(path), SCENE)


@bomb("trees: a row of many columns")
def _(folder):
    columns = 60_000
    path = folder / "a.csv"
    path.write_text(
        "x,y,height,radius," + ",".join(f"a{k}" for k in range(columns)) + "\n" + "1," * (columns + 3) + "1\n"
    )
    return lambda: at.from_trees(path, radius="radius")


@bomb("trees: many trees in one place")
def _(folder):
    path = folder / "a.csv"
    path.write_text("x,y,height,radius\n" + "1,1,1,1\n" * 20_000)
    return lambda: at.from_trees(path, radius="radius")


@bomb("footprints: a ring of many corners")
def _(folder):
    angle = np.linspace(0.0, 2.0 * np.pi, 25_000)
    ring = np.round(np.stack([np.cos(angle), np.sin(angle)], 1) * [[1e6], [3e5]][0], 2)
    return footprints(folder, [[*ring[:-1].tolist(), ring[0].tolist()]])


@bomb("footprints: many holes")
def _(folder):
    corners = np.array([[0, 0], [0, 1], [1, 0], [0, 0]])
    holes = [(corners + [2 * x, 2 * y]).tolist() for x in range(80) for y in range(80)]
    return footprints(folder, [[[-9, -9], [500, -9], [500, 500], [-9, 500], [-9, -9]], *holes])


def footprints(folder: Path, rings) -> Reader:
    feature = {"type": "Feature", "properties": {"height": 5}, "geometry": {"type": "Polygon", "coordinates": rings}}
    crs = {"type": "name", "properties": {"name": "urn:ogc:def:crs:EPSG::28992"}}
    path = folder / "a.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "crs": crs, "features": [feature]}, separators=(",", ":")))
    return loaded(path)


# --- Rasters ----------------------------------------------------------------------------------------------------------


@bomb("raster: a grid of text that declares many cells")
def _(folder):
    head = "ncols 1000000\nnrows 1000000\nxllcorner 0\nyllcorner 0\ncellsize 1\n"
    return written(folder / "a.asc", head + "1 2 3\n")
