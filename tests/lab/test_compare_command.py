"""`antumbra compare`."""

import base64
import io
import os
import shlex
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from antumbra.engine.accelerator import Accelerator
from antumbra.lab.compare_command import CompareArguments, milliseconds, number, ratio

SMALL = "procedural:atrium?triangles=2000"
PLANS = "bsah+single", "grid32+lbvh+multifrusta", "cones"


@pytest.fixture
def compare(cli):
    def run(*arguments, scene=SMALL, plans=PLANS):
        named = [word for plan in plans for word in ("--plan", plan)]
        return cli("compare", scene, "--size", "48x32", "--spp", 4, "--rounds", 2, *named, *arguments)

    return run


class _Page(HTMLParser):
    """The pictures, the texts of table cells, and the addresses of a page."""

    def __init__(self, text):
        super().__init__()
        self.pictures, self.cells, self.others = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        for name, value in attributes:
            if name in ("src", "href"):
                (self.pictures if tag == "img" else self.others).append(value)
        if tag in ("td", "th"):
            self.cells.append("")

    def handle_data(self, data):
        if self.cells:
            self.cells[-1] += data


def test_everything_as_json(compare, tmp_path):
    told = compare("--json", "--html", "a.html").json()
    assert (told["output"], told["page"], told["rounds"], told["spp"]) == ("compare.png", "a.html", 2, 4)
    assert sorted(os.listdir(tmp_path)) == ["a.html", "compare.png"]
    assert told["same_bits"] is True and told["reference"] == PLANS[0] and "plan" not in told
    assert told["scene"]["name"] == "atrium" and told["camera"]["width"] == 48 and len(told["lights"]) == 1
    assert {"processor", "cores", "threads", "antumbra", "python", "numpy", "numba"} <= told["machine"].keys()
    assert [one["plan"] for one in told["plans"]] == list(PLANS)
    least = min(one["timings"]["total"] for one in told["plans"])
    for one in told["plans"]:
        assert one["exact"] is True and one["difference"] == {"bits": 0, "pixels": 0, "first": None}
        assert one["counters"]["rays"] == one["rays"] == told["rays"] > 0 < one["mrays_per_second"]
        assert len(one["rounds"]) == 2 and one["ratio"] == one["timings"]["total"] / least and one["tests_per_ray"] > 0
    assert np.array(told["plans"][0]["windows"]).shape == (2, 3) and told["plans"][2]["windows"] is None


def test_one_picture_of_all(compare, tmp_path):
    assert compare("--quiet", "-o", "a.png") == (0, "", "")
    picture = np.asarray(Image.open(tmp_path / "a.png")).astype(int)
    assert picture.shape[0] > 32 and picture.shape[1] > 4 * 240
    assert compare("--quiet", "-o", "b.png", plans=[*PLANS, "bsah+wide", "srdh+wide"]).code == 0
    more = np.asarray(Image.open(tmp_path / "b.png"))
    assert more.shape[0] > picture.shape[0] + 32 and more.shape[1] < picture.shape[1]  # two rows of three


def test_for_people(compare):
    done = compare("--html", "a.html")
    assert (done.code, done.err) == (0, "")
    words = (
        "compare.png",
        "a.html",
        "atrium",
        "48x32",
        "rectangular light of ",
        "identical for all plans",
        "median of 2",
        "1x",
    )
    for word in (*PLANS, *words, "trace", "total", "Mrays/s", "box tests", "tests per ray"):
        assert word in done.out, word


def test_a_page_that_needs_nothing_else(compare, tmp_path):
    assert compare("--quiet", "--html", "a.html", "--light", "point:0,3,0@50").code == 0
    text = (tmp_path / "a.html").read_text(encoding="utf-8")
    page = _Page(text)
    assert page.others == [] and "http" not in text and "<script" not in text
    sizes = []
    for address in page.pictures:
        kind, _, data = address.partition(",")
        assert kind == "data:image/png;base64"
        sizes.append(Image.open(io.BytesIO(base64.b64decode(data))).size)
    assert sizes[:-1] == [(48, 32)] * 4 and sizes[-1][0] > sizes[-1][1]
    cells = [cell.strip() for cell in page.cells]
    for word in (*PLANS, "trace", "total", "box tests", "processor", "numba"):
        assert word in cells, word
    assert any("point light (50 cd)" in cell for cell in cells)
    assert "identical for all plans" in text and "point:0,3,0@50" in text


def test_text_of_the_user_is_no_markup(compare, tmp_path):
    name = "a<b>&amp;.obj"
    (tmp_path / name).write_text("v -1 0 -1\nv 1 0 -1\nv 1 0 1\nf 3 2 1\n")
    assert compare("--quiet", "--html", "a.html", scene=name).code == 0
    text = (tmp_path / "a.html").read_text()
    assert "<b>" not in text and "a&lt;b&gt;&amp;amp;.obj" in text


def test_options_of_a_picture(compare):
    more = "--sampler", "halton", "--filter", "--adaptive-spp", 8, "--bounce", 1, "--gbuffer", "rays", "--threads", 1
    told = compare("--json", *more, "--exposure", 2, "--light", "disk:0,4,0:0,-1,0:0.5", "--light", "0").json()
    assert (told["sampler"], told["filter"], told["adaptive"], told["bounce"]) == ("halton", True, 8, 1)
    assert (told["gbuffer"], told["machine"]["threads"], len(told["lights"])) == ("rays", 1, 2)
    assert told["same_bits"] is True
    told = compare("--json", "--vpl", 50, "--srdh-rays", 8, plans=["srdh+wide", "bsah+wide"]).json()
    assert told["srdh_rays"]["size"] == 8 and told["lights"][-1]["count"] > 1


def test_the_command_is_given_again():
    given = CompareArguments(
        "a b.glb", ["bsah+single", "cones"], light=["0", "-1"], filter=True, adaptive_spp=8, camera="-1,0,0:0,0,0"
    )
    words = shlex.split(given.command())
    assert words[:3] == ["antumbra", "compare", "a b.glb"]
    assert words[3:] == [
        *("--plan", "bsah+single", "--plan", "cones", "--camera=-1,0,0:0,0,0", "--light", "0", "--light=-1"),
        *("--filter", "--adaptive-spp", "8"),
    ]
    houses = CompareArguments("b.gpkg", ["cones"], height="h", terrain=[Path("a b.tif"), Path("c.tif")])
    options = ["--height", "h", "--terrain", "a b.tif", "--terrain", "c.tif", "--plan", "cones"]
    assert shlex.split(houses.command())[2:] == ["b.gpkg", *options]


def test_a_moment_of_an_animation_and_nothing_seen(compare):
    done = compare("--time", 1, "--camera", "900,900,900:999,999,999")
    assert done.code == 0 and "nan" not in done.out.lower() and "sees no surface" in done.out


def test_a_store(cli, compare):
    assert cli("build", "procedural:city?triangles=5k", "-o", "city.antumbra", "-q").code == 0
    done = compare("--max-memory", "3G", scene="city.antumbra", plans=["bsah+chcrt", "bsah+chcrt:20"])
    assert done.code == 0 and "chunks: loaded" in done.out
    compare(scene="city.antumbra").refused("is in a store", "bsah+chcrt")


@pytest.mark.parametrize("plan, code", [("bsah+wide", 1), ("bsah+chcrt:20", 0)])
def test_bits_that_differ(compare, monkeypatch, tmp_path, plan, code):
    answer = Accelerator.answer_all

    def spoilt(self, accelerated, queries, *rest):
        bits = answer(self, accelerated, queries, *rest)
        if str(self.plan) == plan:
            bits[0][3, 7] ^= np.uint64(1)
        return bits

    monkeypatch.setattr(Accelerator, "answer_all", spoilt)
    done = compare("--html", "a.html", "--no-filter", plans=["bsah+single", plan])
    line = f"{plan} differs from bsah+single: 1 of the bits, 1 of the pixels, first at (7, 3)"
    assert done.code == code and line in " ".join(done.out.split()) and line in (tmp_path / "a.html").read_text()
    assert ("please report it" in done.err) == ("class=bad" in (tmp_path / "a.html").read_text()) == bool(code)
    assert ("this plan is not exact" in done.out) != bool(code) and "identical for" not in done.out
    assert "identical for all other plans" in compare(plans=["bsah+single", plan, "lbvh+single"]).out


@pytest.mark.parametrize(
    "arguments, words",
    [
        (("--plan", "bsah+single"), ["named twice"]),
        (("--plan", "nothing+single"), ["'nothing'"]),
        (("--rounds", "0"), ["--rounds"]),
        (("--srdh-rays", "8"), ["is ray-guided"]),
        (("--plan", "srdh+single", "--srdh-rays", "last-frame"), ["last-frame", "animations"]),
        (("--ao", "1", "--bounce", "2"), ["--ao", "--bounce"]),
        (("--exposure", "-1"), ["exposure"]),
        (("--max-memory", "much"), ["--max-memory"]),
        (("-o", "a.exr"), [".exr", ".png"]),
        (("-o", "none/a.png"), ["none", "does not exist"]),
        (("--html", "a.txt"), [".txt", ".html"]),
        (("--html", "none/a.html"), ["none", "does not exist"]),
        (("--light", "5"), ["no light 5"]),
        (("--sampler", "dice"), ["dice"]),
    ],
)
def test_what_is_wrong_is_said(compare, tmp_path, arguments, words):
    compare(*arguments).refused(*words)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("plans", [[], ["bsah+single"]])
def test_two_plans_are_wanted_before_the_scene_is_read(compare, plans):
    compare(scene="not_there.glb", plans=plans).refused("two plans or more", "--plan")


def test_numbers():
    assert [number(v) for v in (None, 0.04567, 3.14159, 99.96, 1234.5)] == ["-", "0.0457", "3.14", "100", "1,234"]
    assert [milliseconds(s) for s in (0.0, 1e-6, 0.0123, 12.3)] == ["-", "<0.1", "12.3", "12,300"]
    assert (ratio(3.0, 2.0), ratio(1.0, 0.0)) == ("1.5x", "-")
