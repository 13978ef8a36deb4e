"""`antumbra explain`."""

import os

import numpy as np
import pytest
from PIL import Image

from antumbra.engine.accelerator import Accelerator

SMALL = "procedural:atrium?triangles=2000"
CLASSES = ["path to the hit", "false hits", "unoccluded"]


@pytest.fixture
def explain(cli):
    def run(*arguments, scene=SMALL):
        return cli("explain", scene, "--size", "48x32", "--spp", 4, *arguments)

    return run


def test_random_order_and_srdh_are_compared(explain, tmp_path):
    told = explain("--json").json()
    assert [one["plan"] for one in told["plans"]] == ["bsah+single:random", "srdh+single"]
    first, second = told["plans"]
    assert 0 < told["blocked"] < told["rays"] and told["same_bits"] is True
    assert first["ratio"] == 1 and 0 < second["ratio"] == second["box_tests"] / first["box_tests"]
    for one in told["plans"]:
        assert list(one["classes"]) == CLASSES and sum(one["classes"].values()) == one["box_tests"]
        assert one["box_tests_per_ray"] == one["box_tests"] / told["rays"] and one["triangle_tests_per_ray"] > 0
        assert sum(one["depths"]["histogram"]) == told["blocked"] and one["depths"]["mean"] >= 1
    assert told["frequent"]["triangles"] >= 1 and told["blocked"] / 2 <= told["frequent"]["rays"] <= told["blocked"]
    assert (told["spp"], told["srdh_rays"], told["previous"], told["camera"]["width"]) == (4, None, None, 48)
    picture = np.asarray(Image.open(tmp_path / told["output"])).astype(int)
    assert told["output"] == "antumbra-explain.png" and picture.shape[1] > 2 * 48
    assert (picture[..., 0] > picture[..., 2] + 100).any() and (picture == 0).all(axis=-1).any()


def test_for_people(explain, tmp_path):
    plans = "bsah+single", "grid32+lbvh+multifrusta", "bsah+refit+wide", "srdh:distance+single:srdh"
    done = explain(*(word for plan in plans for word in ("--plan", plan)), "--srdh-rays", "8,bounce", "-o", "a.png")
    assert done.code == 0 and (tmp_path / "a.png").exists()
    for word in (
        *plans,
        *CLASSES,
        "a.png",
        " triangles",
        "% of them blocked",
        "identical for all",
        "deepest",
        " - ",
    ):
        assert word in done.out, word
    assert explain("--plan", plans[0], "--quiet") == (0, "", "")


def test_which_rays_the_builder_is_shown(explain):
    def steps(*arguments):
        told = explain("--plan", "srdh+single", "--json", *arguments).json()
        return told["plans"][0]["box_tests"], told["rays"], told["srdh_rays"]

    boxes, rays, _ = steps()
    few = steps("--srdh-rays", "2")
    assert few[0] != boxes and few[1:] == (rays, {"size": 2, "spp": 4, "bounce": False, "last_frame": False})
    assert steps("--srdh-rays", "16") == (boxes, rays, {**few[2], "size": 16})
    assert steps("--srdh-rays", "last-frame", "--previous", "0.1")[0] == boxes  # nothing moves in this scene


def test_nothing_seen_has_no_steps(explain):
    away = "--camera", "900,900,900:999,999,999"
    told = explain(*away, "--json").json()
    assert told["rays"] == told["blocked"] == told["frequent"]["triangles"] == 0
    assert {(one["box_tests_per_ray"], one["ratio"], one["depths"]["mean"]) for one in told["plans"]} == {(None,) * 3}
    done = explain(*away)
    assert done.code == 0 and "nan" not in done.out.lower()


def test_without_triangles_that_block(cli, square_obj):
    told = cli("explain", square_obj, "--size", 16, "--plan", "srdh+single", "--json").json()
    assert told["blocked"] == 0 < told["rays"] and told["plans"][0]["classes"]["unoccluded"] > 0
    assert told["output"] == "square-explain.png"


def test_plans_that_differ_are_a_bug_and_leave_no_picture(explain, monkeypatch, tmp_path):
    answer = Accelerator.answer
    monkeypatch.setattr(Accelerator, "answer", lambda self, *a: answer(self, *a) ^ np.uint64(self.plan.build == "srdh"))
    done = explain()
    assert (done.code, done.out) == (1, "") and "please report this" in done.err and done.err.count("\n") == 1
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize(
    "arguments, words",
    [
        (("--plan", "srdh"), ["'srdh'", "no tracer"]),
        (("--plan", "bsah+single", "--plan", "nothing+single"), ["'nothing'"]),
        (("--plan", ""), ["plan ''"]),
        (("--plan", "bsah+single", "--plan", "grid32+cones"), ["'grid32+cones'", "no BVH"]),
        (("--srdh-rays", "0"), ["--srdh-rays 0", "1"]),
        (("--srdh-rays", "many"), ["'many'", "16, 32 or all"]),
        (("--srdh-rays", "32", "--plan", "bsah+single"), ["bsah+single", "is ray-guided"]),
        (("--srdh-rays", "last-frame"), ["last-frame", "--previous"]),
        (("--previous", "0"), ["--previous is 0"]),
        (("--previous", "nan"), ["--previous is nan"]),
        (("--size", "0"), ["--size"]),
        (("-o", "a.exr"), [".exr", ".png"]),
        (("-o", "none/a.png"), ["none", "does not exist"]),
        (("--spp", "0"), ["spp"]),
        (("--light", "5"), ["no light 5"]),
        (("--time", "x"), ["--time"]),
    ],
)
def test_what_is_wrong_is_said(explain, tmp_path, arguments, words):
    explain(*arguments).refused(*words)
    assert os.listdir(tmp_path) == []


def test_the_plan_is_checked_before_the_scene_is_read(explain):
    explain("--srdh-rays", "32", "--plan", "bsah+single", scene="not_there.glb").refused("is ray-guided")
