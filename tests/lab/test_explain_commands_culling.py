"""`antumbra culling`."""

import numpy as np
from PIL import Image

SMALL = "procedural:cellar?triangles=20k"


def test_the_share_that_is_left_and_a_picture_of_it(cli, tmp_path):
    told = cli("culling", SMALL, "--size", "48x32", "--json").json()
    assert 0 < told["kept"] < told["triangles"] and told["share"] == told["kept"] / told["triangles"] < 0.9
    assert 0 < told["marked"] < told["cells"] == 32**3 and told["sources"] > 1 <= told["targets"]
    picture = np.asarray(Image.open(tmp_path / told["output"])).astype(int)
    assert picture.shape == (32, 3 * 48, 3)
    red, blue = picture[..., 0], picture[..., 2]
    for panel in range(3):
        part = slice(48 * panel, 48 * (panel + 1))
        assert (red > blue + 40)[:, part].any() and (panel == 0 or (blue > red + 40)[:, part].any())


def test_for_people_by_other_grids_and_lights(cli, tmp_path):
    for culler in ("grid16", "grid64", "grid32:paper"):
        done = cli("culling", SMALL, "--size", "32x32", "--culler", culler, "--light", "sun:1,-1,0", "-o", "a.png")
        assert done.code == 0 and "% " in done.out.replace("%\n", "% \n") and (tmp_path / "a.png").exists()


def test_nothing_seen_is_nothing_left(cli):
    told = cli("culling", SMALL, "--size", "16x16", "--camera", "900,900,900:999,999,999", "--json").json()
    assert told["kept"] == told["cells"] == told["marked"] == 0


def test_what_is_wrong_is_said(cli, tmp_path):
    cli("culling", SMALL, "--culler", "grid33").refused("grid33", "grid32")
    cli("culling", SMALL, "-o", "a.exr").refused(".exr", ".png")
    assert list(tmp_path.iterdir()) == []
