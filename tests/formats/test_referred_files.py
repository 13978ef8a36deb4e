"""Digests of a scene cover the files that it refers to."""

import json

import pytest

from antumbra.formats.referred_files import referred_files

MTL = "newmtl a\nKd 1 0 0\nmap_Kd -s 2 2 2 pictures\\wood.png\nmap_d holes.png\nmap_Bump bumps.png\n"
SCENES = {
    "a.obj": (
        "v 0 0 0\nmtllib one.mtl\n mtllib \\\ntwo.mtl\r\nusemtl a\nmtllib one.mtl\n",
        ["one.mtl", "pictures/wood.png", "holes.png", "two.mtl"],
    ),
    "outside.obj": ("mtllib ../one.mtl\nmtllib \n", []),
    "plain.obj": ("v 0 0 0\n", []),
    "a.gltf": (
        json.dumps({"buffers": [{"uri": "a%20b.bin"}, {"uri": "data:,x"}, {}], "images": [{"uri": "wood.png"}]}),
        ["a b.bin", "wood.png"],
    ),
    "damaged.gltf": ('{"buffers": 3}', []),
    "no.gltf": ("{", []),
    "a.glb": ("", []),
    "a.ply": ("", []),
    "a.vrt": ("", None),
}


@pytest.mark.parametrize("name", SCENES)
def test_the_files_that_a_file_refers_to(tmp_path, name):
    text, files = SCENES[name]
    (tmp_path / name).write_text(text, newline="")
    (tmp_path / "one.mtl").write_text(MTL)
    expected = None if files is None else [(tmp_path / file).resolve() for file in files]
    assert referred_files(tmp_path / name) == expected


def test_files_of_a_folder_are_not_known(tmp_path):
    assert referred_files(tmp_path) is None and referred_files(tmp_path / "missing.obj") == []
