"""Instances on the command line."""

import numpy as np
from PIL import Image

from gltf_files import TETRAHEDRON, TETRAHEDRON_FACES, Gltf


def _file(folder):
    made = Gltf()
    mesh = made.mesh(made.primitive(TETRAHEDRON, TETRAHEDRON_FACES))
    for x in range(3):
        made.node(mesh=mesh, translation=[2 * x, 0, 0], scale=[1, 1 + x, 1])
    return made.write(folder)


def test_a_plan_says_whether_it_traces_instances(cli, tmp_path):
    path = _file(tmp_path)
    options = "--size", "24x16", "--spp", 2, "--explain-plan"
    done = cli("render", f"{path}?instances=on", *options, "-o", "a.png")
    assert "The plan bsah+wide traced 3 copies of 1 mesh as instances." in done.out
    done = cli("render", f"{path}?instances=on", *options, "--plan", "bsah+single", "-o", "b.png")
    assert "cannot trace instances, so 3 copies of 1 mesh were flattened; bsah+wide can" in done.out
    done = cli("render", path, *options, "-o", "c.png")
    assert done.code == 0 and "instances" not in done.out
    pictures = [np.asarray(Image.open(f"{name}.png")) for name in "abc"]
    assert pictures[0].std() > 1.0
    for other in pictures[1:]:
        np.testing.assert_array_equal(pictures[0], other)


def test_a_summary_of_a_file_of_instances(cli, tmp_path):
    told, flat = (cli("info", f"{_file(tmp_path)}{how}", "--json").json() for how in ("?instances=on", ""))
    assert told["triangles"] == flat["triangles"] == 12
