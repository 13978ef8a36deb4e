"""`antumbra bench`: tables are printed. Their contents are not tested here."""

import json

import numpy as np
import pytest

from antumbra.base.extras import plugins_of

TINY = ("--size", "40x24", "--cellar", "5k", "--video", "5k", "--frames", "2", "--rounds", "1")


@pytest.fixture
def culling(cli, monkeypatch):
    """Runs the benchmark of pre-BVH culling with small scenes."""
    from antumbra.lab.papers.pre_bvh_culling import culling_views

    monkeypatch.delenv("ANTUMBRA_SCENES", raising=False)
    whole = culling_views.procedural
    monkeypatch.setattr(
        culling_views, "procedural", lambda name, triangles: whole(name, triangles=min(triangles, 5000))
    )
    return lambda *more: cli("bench", "pre-bvh-culling", *TINY, *more)


def test_tables_of_pre_bvh_culling(culling):
    told = culling("--json", "--tracer", "single").json()
    assert told["same_bits"] and told["tracers"] == ["single"]
    assert {(t["figure"], t["method"]) for t in told["time_to_image"]} >= {
        ("Figure 6", "TL-LBVH culled"),
        ("Figure 6", "BSAH, grid32"),
        ("atrium", "BSAH"),
    }
    assert all(list(t["trace"]) == ["1", "10", "100"] for t in told["time_to_image"])
    assert {(t["figure"], t["method"]) for t in told["figures"]} == {
        (f, m) for f in ("Figure 6", "atrium") for m in ("LBVH", "LBVH culled", "LBVH, grid32")
    }
    assert {(g["figure"], g["marked"]) for g in told["grids"]} == {
        (f, m) for f in ("Figure 6", "atrium") for m in ("hulls", "as published", "convex region")
    }
    assert len(told["video"]) == 2 * (1 + 5 + 3) + 2 and told["random"] == []
    for marked in ("hulls", "as published"):
        assert {g["grid"] for g in told["video"] if g["marked"] == marked} == {16, 32, 64, 128, 256}
    for g in told["grids"] + told["video"]:
        assert 0 < g["remaining"] <= 1 and (g["grid"] == 0) == (g["steps"] == {})
        assert set(g["trace"]) == set(g["build"])
    assert all(set(g["trace"]) == {"lbvh+single", "tl-lbvh+single"} for g in told["video"])


def test_for_people_and_the_plot(culling, tmp_path):
    pytest.importorskip("matplotlib")
    done = culling("--plot", "even.png", "--output", "found")
    assert done.code == 0 and "the same by all methods" in done.out and "as published" in done.out
    parts = "Tables 1 and 2", "scan and pack", "Table 3", "Fig. 2b", "Table 4", "single, 1 spp", "multifrusta, 1 spp"
    found = (tmp_path / "found" / "pre-bvh-culling.md").read_text()
    assert all(part in found for part in (*parts, "with 15 samples", "contradicts itself", "1.405"))
    assert (tmp_path / "even.png").stat().st_size > 10_000
    pictures = {path.name for path in (tmp_path / "found").glob("pre-bvh-culling-*.png")}
    assert pictures == {f"pre-bvh-culling-{name}.png" for name in ("atrium", "figure6", "cells")}


SMALL = ("procedural:cellar?triangles=2k", "--size", "24", "--timed-size", "16", "--rounds", "1")


def test_tables_of_srdh(cli):
    told = cli("bench", "srdh", "--scene", *SMALL, "--json").json()
    assert told["same_bits"] and told["size"] == [24, 24] and told["timed_size"] == [16, 16]
    counts = {(c["method"], c["pixels"]): c for c in told["counts"]}
    assert counts["random", None]["relative"] == 1 and counts["srdh", 16]["relative"] < 1
    assert {c["scene"] for c in told["counts"]} == {"cellar?triangles=2k"}
    ((shown),) = told["rtsah"]
    assert 0 < shown["lines"] < 1 < shown["lines_reversed"] and shown["rays"] > 0 < shown["rays_reversed"]
    assert [b["pixels"] for b in told["builds"]] == [16, 32]
    assert all(b["both"] > 1 and b["instead"] > 0 and b["rays"] > 0 for b in told["builds"])
    assert len({(r["build"], r["tracer"]) for r in told["renders"]}) == len(told["renders"]) == 8
    assert all(r["traced"] > 0 for r in told["renders"]) and len(told["gains"]) == 4
    assert {d["method"] for d in told["trees"]} == {"SAH", "srdh, published"}
    assert told["memory"][0]["growth"] == pytest.approx(2.0) and len(told["saved"]) == 2


def test_srdh_for_people_and_the_plot(cli, tmp_path):
    pytest.importorskip("matplotlib")
    done = cli("bench", "srdh", "--scene", *SMALL, "--plot", "srdh.png")
    assert done.code == 0 and "the same by all methods" in done.out
    for part in (
        "Figure 2",
        "Figure 3",
        "Section 4.1",
        "Section 5",
        "Figure 4",
        "Figure 5",
        "Table 1",
        "multifrusta",
        "(paper: BEDROOM)",
        "(paper: MADSCI)",
        "RTSAH",
    ):
        assert part in done.out
    assert (tmp_path / "srdh.png").stat().st_size > 10_000


@pytest.fixture
def hierarchy(cli, tmp_path, monkeypatch):
    """Runs the benchmark of ray hierarchies with a small moving scene and procedural ones."""
    from antumbra import procedural

    vertices = procedural("blinds", triangles=2000).triangles().vertices.reshape(-1, 3)
    (tmp_path / "bart_robots").mkdir()
    np.save(tmp_path / "bart_robots" / "frames.npy", np.stack([vertices, 1.1 * vertices]))
    np.save(tmp_path / "bart_robots" / "faces.npy", np.arange(len(vertices), dtype=np.int32).reshape(-1, 3))
    monkeypatch.setenv("ANTUMBRA_SCENES", str(tmp_path))
    small = "--size", "24", "--frames", "3", "--frame-size", "16", "--rounds", "1"
    return lambda *more: cli("bench", "ray-hierarchy", *small, *more)


def test_tables_of_ray_hierarchies(hierarchy):
    told = hierarchy("--scene", "procedural:cellar?triangles=2k", "--json").json()
    assert told["same_bits"] and told["size"] == [24, 24] and told["spreads"] == [] and told["cull_faces"] == "back"
    assert {b["variant"] for b in told["figure 7"]} == {"PreciseSorted", "PreciseSEA", "PreciseEATP", "PreciseSEATP"}
    assert told["film"] == {"pictures": [], "costs": []} and told["claims"] == []
    ((shown),) = told["pictures"]
    assert shown["picture"] == "cellar?triangles=2k" and 0 < shown["blocked"] < shown["rays"]
    assert {c["variant"] for c in told["costs"]} >= {"cones", "Spheres", "PreciseSEATP"}
    assert all(c["tests"] > 0 and c["seconds"] > 0 and 0 < c["passed"] < c["nodes"] for c in told["costs"])


def test_ray_hierarchies_for_people_and_the_plot(hierarchy, tmp_path):
    pytest.importorskip("matplotlib")
    done = hierarchy("--plot", "cones.png")
    assert done.code == 0 and "the same by all methods" in done.out, done.err
    for part in (
        "Figures 6 and 7",
        "bart_robots, 0.02 s",
        "3 frames of animations",
        "steadiest in bart_robots",
        "(Figure 7;",
    ):
        assert part in done.out
    assert (tmp_path / "cones.png").stat().st_size > 10_000


def test_variants_that_would_take_long_are_not_run(hierarchy):
    done = hierarchy("--scene", "procedural:cellar?triangles=2k", "--limit", "0")
    assert done.code == 0 and "not run: predicted" in done.out and "No animation" in done.out


WALKED = "--size", "24", "--frames", "3", "--compared", "2"


def test_tables_of_chc_rt(cli):
    told = cli("bench", "chc-rt", "--scene", SMALL[0], *WALKED, "--json").json()
    assert told["same_answers"] and told["differs"] == 0 and told["peak_resident"] > 1e6
    turns = {(t["view"], t["kind"], t["method"], t["frame"]): t for t in told["times"]}
    assert {(v, k, m) for v, k, m, _ in turns if m == "chcrt" or m == "single"} == {
        (v, k, m)
        for v in ("near", "far")
        for k in ("primary", "AO", "diffuse", "soft shadows")
        for m in ("chcrt", "single")
    }
    frames = [{f for *_, m, f in turns if (m == "chcrt") == ours} for ours in (True, False)]
    assert frames == [{0, 1, 2}, {1, 2}]
    assert all(t["rays"] > 0 and t["seconds"] > 0 for t in told["times"])
    assert all(bool(t["statistics"]) == (t["method"] == "chcrt") for t in told["times"])
    assert {t["sampler"] for t in told["randomisation"]} == {"halton:0", "halton:18", "halton:36", "halton:full"}
    assert {t["method"] for t in told["aggressive"]} == {"chcrt", "chcrt:20", "chcrt:100", "chcrt:200"}
    assert all((t["error"] is None) == (t["method"] == "chcrt") for t in told["aggressive"])


def test_chc_rt_for_people_and_the_plot(cli, tmp_path):
    pytest.importorskip("matplotlib")
    done = cli("bench", "chc-rt", "--scene", SMALL[0], *WALKED, "--plot", "chcrt.png")
    assert done.code == 0 and "the same by all methods" in done.out, done.err
    for part in ("Table 2", "Figure 8", "Table 4", "Table 5", "(paper: Powerplant)", "multifrusta", "the paper's"):
        assert part in done.out
    assert "MB moved" not in done.out
    assert (tmp_path / "chcrt.png").stat().st_size > 10_000


def test_chc_rt_out_of_core(cli, tmp_path):
    cli("build", SMALL[0], "-o", "small.antumbra", "--quiet")
    told = cli("bench", "chc-rt", "--store", "small.antumbra", *WALKED, "--json").json()
    assert told["same_answers"] and {t["method"] for t in told["store"]} == {"lru", "round-robin"}
    assert {t["method"] for t in told["mapped"]} == {"memory-mapped"}
    assert {t["kind"] for t in told["bounces"]} == {"camera", "bounce 1", "bounce 2", "bounce 3"}
    first = [t["statistics"] for t in told["store"] if (t["kind"], t["frame"]) == ("primary", 0)]
    assert len(first) == 4 and all(t["loaded"] > 0 and t["bytes"] > 0 for t in first)
    neglecting = told["aggressive"]
    assert {(t["view"], t["method"], t["kind"]) for t in neglecting} == {
        (v, m, "diffuse") for v in ("near", "far") for m in ("chcrt", "chcrt:20", "chcrt:100", "chcrt:200")
    }
    assert all((t["error"] is None) == (t["method"] == "chcrt") and "bytes" in t["statistics"] for t in neglecting)
    done = cli("bench", "chc-rt", "--store", "small.antumbra", *WALKED, "--table", "store", "--table", "aggressive")
    assert "round-robin" in done.out and "chcrt:200" in done.out and "Figure 8" not in done.out
    assert "not compared" not in done.out
    alone = cli("bench", "chc-rt", "--store", "small.antumbra", *WALKED, "--table", "aggressive", "--json").json()
    assert alone["same_answers"] is None and "store" not in alone
    cli("bench", "chc-rt", "--scene", "small.antumbra").refused("small.antumbra", "--store")


QUICK = {
    "chc-rt": {"scene": [SMALL[0]], "stored": "5k", "size": "24", "frames": 2},
    "multi-frusta": {
        "scene": ["procedural:atrium?triangles=2k"],
        "size": "24",
        "primary_size": "24",
        "lights_size": "24",
    },
    "pre-bvh-culling": {"size": "40x24", "cellar": "5k"},
    "ray-hierarchy": {"scene": [SMALL[0]], "size": "24"},
    "srdh": {"scene": [SMALL[0]], "size": "24", "timed_size": "16"},
}


def test_all_of_them_write_their_results(culling, cli, tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    points = plugins_of("antumbra.bench")
    assert set(QUICK) <= set(points)
    for name, values in QUICK.items():
        monkeypatch.setattr(points[name].load(), "quick", {**points[name].load().quick, **values})
    done = cli("bench", "all", "--quick", "--output", "found")
    assert done.code == 0, done.err
    for name in QUICK:
        told = json.loads((tmp_path / "found" / f"{name}.json").read_text())
        assert told["about"]["command"] == f"antumbra bench {name} --quick"
        assert f"# antumbra bench {name}\n" in (tmp_path / "found" / f"{name}.md").read_text()
    plots = {path.name for path in (tmp_path / "found").glob("*.png")}
    assert {f"{name}.png" for name in QUICK} - {"multi-frusta.png"} | {"srdh-comparison.png", "srdh-trees.png"} <= plots
    assert len([name for name in plots if "-figure-" in name]) == 5


def test_what_is_wrong_is_said_before_anything_is_measured(cli, tmp_path):
    cli("bench", "srdh", "--scene", "procedural:cellar?triangles=2k", "--scene", "none.glb").refused(
        "none.glb", "cellar"
    )
    cli("bench", "srdh", "--timed-size", "0").refused("--timed-size", "WIDTHxHEIGHT")
    cli("bench", "srdh", "--plot", "srdh.gif").refused(".gif", ".png")
    cli("bench", "pre-bvh-culling", "--tracer", "magic").refused("magic", "single")
    cli("bench", "pre-bvh-culling", "--tracer", "cones").refused("'cones' uses no BVH", "single")
    cli("bench", "pre-bvh-culling", "--sponza", "none.glb").refused("none.glb")
    cli("bench", "pre-bvh-culling", "--plot", "even.gif").refused(".gif", ".png")
    cli("bench", "ray-hierarchy", "--scene", "none.glb").refused("none.glb", "atrium")
    cli("bench", "ray-hierarchy", "--plot", "cones.gif").refused(".gif", ".png")
    cli("bench", "multi-frusta", "--plot", "frusta.gif").refused(".gif", ".png")
    cli("bench", "chc-rt", "--scene", "none.glb").refused("none.glb", "atrium")
    cli("bench", "chc-rt", "--triangles", "10").refused("10", "1000")
    cli("bench", "chc-rt", "--max-memory", "1G").refused("--max-memory", "--store")
    cli("bench", "chc-rt", "--in-core", "47").refused("--in-core", "--store")
    cli("bench", "chc-rt", "--store", "a.antumbra", "--max-memory", "1G", "--in-core", "47").refused("--in-core")
    cli("bench", "chc-rt", "--store", "a.antumbra", "--scene", "city").refused("--store", "--scene")
    cli("bench", "chc-rt", "--scene", SMALL[0], "--table", "store").refused("--table store", "--store")
    cli("bench", "chc-rt", "--store", "a.antumbra", "--stored", "1M").refused("--store", "--stored")
    cli("bench", "chc-rt", "--store", "a.antumbra", "--table", "randomisation").refused("randomisation", "--store")
    cli("bench", "chc-rt", "--table", "aggressive", "--plot", "a.png").refused("--plot", "times")
    assert list(tmp_path.iterdir()) == []


ALONE = {
    "multi-frusta": ("shrinking", "Table 2", "Table 1,"),
    "pre-bvh-culling": ("steps", "Remaining triangles", "Grids, ms"),
    "srdh": ("builds", "Table 1", "Figure 2"),
    "ray-hierarchy": ("pictures", "Nodes tested", "Medians over the frames"),
    "chc-rt": ("scenes", "Table 1", "Table 2"),
}


@pytest.mark.parametrize("name", ALONE)
def test_a_table_is_measured_alone_and_joins_the_others(name, culling, cli, monkeypatch, tmp_path):
    command = plugins_of("antumbra.bench")[name].load()
    monkeypatch.setattr(
        command, "quick", {**command.quick, **QUICK[name], **({"stored": "0"} if name == "chc-rt" else {})}
    )
    table, there, absent = ALONE[name]
    done = cli("bench", name, "--quick", "--table", table, "--output", "found")
    assert done.code == 0, done.err
    assert there in done.out and absent not in done.out
    (first,) = json.loads((tmp_path / "found" / f"{name}.json").read_text())["tables"].items()
    assert first[0] == table and first[1]["parts"] >= 1 and first[1]["commands"] == [f"antumbra bench {name} --quick"]
    again = cli("bench", name, "--quick", "--table", table, "--output", "found")
    assert f"parts measured before: {first[1]['parts']};" in again.err and again.out == done.out
    cli("bench", name, "--table", table, "--plot", "a.png").refused("--plot", "--table")


def test_times_of_the_processor_are_those_of_one_thread(culling, cli):
    cli("bench", "pre-bvh-culling", "--clock", "cpu", "--threads", "2").refused("--clock cpu", "--threads 1")
    told = culling("--table", "times", "--tracer", "single", "--clock", "cpu", "--threads", "1", "--json").json()
    assert told["clock"] == "cpu" and told["threads"] == 1 and told["tables"]["times"]["parts"] == 2
    assert all(t["trace"]["1"] > 0 for t in told["time_to_image"])


SMALL_FRUSTA = "--size", "24", "--primary-size", "40", "--lights-size", "24", "--rounds", "1"


def test_tables_of_multi_frusta(cli):
    done = cli("bench", "multi-frusta", "--scene", "procedural:atrium?triangles=2k", *SMALL_FRUSTA, "--json").json()
    (tables,) = done["rows"].values()
    assert done["cull_faces"] == "back" and done["same_bits"]
    assert list(tables)[1::3] == ["hard shadows", "figure 6", "figure 7"]
    primary, hard, one, two, six, lights, five, seven = tables.values()
    assert list(primary) == ["packet16:paper", "primary:paper", "primary:entries", "multifrusta"]
    assert all(row["rays"] == 40 * 40 and row["box_tests"] > 0 for row in primary.values())
    assert all(row["candidates"] > 0 and row["seconds"] < row["shaded"] for row in primary.values())
    assert all(0 < row["rays"] <= 24 * 24 for row in hard.values()) and 0 < seven["edges"] < 1
    assert five["256 samples"]["rms"] == 0 < five["16 samples"]["rms"]
    assert list(one)[:4] == ["packet16:paper", "packet16", "packet16:samples", "packet256"]
    assert list(one)[4:] == ["multifrusta:paper", "multifrusta"]
    assert len(two) == 4 and len(six) == 6 and len(lights) == 3
    assert (
        all("seconds" not in row for rows in six.values() for row in rows.values()) and one["packet16"]["rounds"] == 1
    )
    rows = [
        *one.values(),
        *two.values(),
        *(row for many in (six, lights) for each in many.values() for row in each.values()),
    ]
    assert all(row["rays"] > 0 and row["triangle_tests"] > 0 for row in rows)


def test_multi_frusta_for_people_and_the_plot(cli, tmp_path):
    pytest.importorskip("matplotlib")
    asked = "--scene", "procedural:atrium?triangles=2k", *SMALL_FRUSTA, "--plot", "frusta.png"
    done = cli("bench", "multi-frusta", *asked)
    assert done.code == 0 and "the same by all methods" in done.out and "Sec. 5.2" in done.out
    assert all(f"{text}, atrium" in done.out for text in ("Table 1", "Table 2", "Figure 5", "Figure 6", "Figure 7"))
    assert "edge^" in done.out and "Operations per 16 rays" in done.out and "Fairy Forest, S-Frusta" in done.out
    assert "(1 round)" in done.out
    assert (tmp_path / "frusta.png").stat().st_size > 10_000
