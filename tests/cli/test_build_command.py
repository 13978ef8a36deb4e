import pytest

import antumbra as at
from antumbra.cli import arguments
from antumbra.store.store_file import open_store

SCENE = "procedural:cellar?triangles=2k"


def test_several_scenes(cli, square_obj):
    told = cli("build", SCENE, square_obj, "-o", "a.antumbra", "--json").json()
    scene = at.load("a.antumbra")
    assert told["triangles"] == scene.n_triangles == at.procedural("cellar", triangles=2000).n_triangles + 2
    assert told["bytes"] == scene.store.path.stat().st_size and told["chunks"] == len(scene.store)
    assert told["path"] == "a.antumbra" and told["max_memory"] == 4 << 30 and told["seconds"]["total"] > 0.0
    assert told["peak_resident"] is None or told["peak_resident"] > told["bytes"]
    assert scene.name == "cellar + square" and len(scene.cameras) == 1


def test_for_people(cli, square_obj):
    done = cli("build", square_obj, "-o", "s.antumbra", "--up", "z", "--threads", "1")
    assert done.code == 0
    for words in ("s.antumbra", "2 in 1 chunk", "bytes per triangle", "time"):
        assert words in done.out, done.out
    assert at.load("s.antumbra").up == "z"
    assert cli("build", square_obj, "-o", "s.antumbra", "--quiet") == (0, "", "")


def test_a_city_is_streamed(cli, monkeypatch):
    monkeypatch.setattr("antumbra.cli.build_command.open_for_store", None)  # the city is not made in memory
    told = cli("build", "procedural:city?triangles=20k&seed=2", "-o", "c.antumbra", "--json").json()
    assert told["triangles"] == at.procedural("city", triangles=20_000, seed=2).n_triangles


def test_info(cli):
    cli("build", SCENE, "-o", "a.antumbra", "--quiet")
    told = cli("info", "a.antumbra", "--json").json()
    assert told["triangles"] == sum(told["chunks"]["triangles"]) and told["checked"] is False
    assert told["meshes"] == [] and told["built"]["builder"] == "bsah" and len(told["cameras"]) == 1
    shown = cli("info", "a.antumbra", "--check").out
    for words in ("chunks", "checksums", "bytes per triangle", "camera 0", "light 0"):
        assert words in shown, shown
    assert cli("info", "a.antumbra", "--check", "--json").json()["checked"] is True


def test_info_finds_damage(cli, tmp_path):
    cli("build", SCENE, "-o", "a.antumbra", "--quiet")
    data = bytearray((tmp_path / "a.antumbra").read_bytes())
    data[5000] ^= 1
    (tmp_path / "a.antumbra").write_bytes(data)
    assert cli("info", "a.antumbra").code == 0
    cli("info", "a.antumbra", "--check").refused("a.antumbra", "chunk 0 of 1", "damaged")


@pytest.mark.parametrize(
    "given, words",
    [
        (("none.glb", "-o", "a.antumbra"), ["none.glb"]),
        ((SCENE, "-o", "a.png"), ["a.png", ".antumbra"]),
        ((SCENE, "-o", "gone/a.antumbra"), ["gone", "make it first"]),
        ((SCENE, "-o", "a.antumbra", "--max-memory", "1M"), ["--max-memory is 1M", "from 384M"]),
        ((SCENE, "-o", "a.antumbra", "--max-memory", "much"), ["--max-memory", "512M"]),
        ((SCENE, "-o", "a.antumbra", "--up", "z"), ["--up"]),
        (("procedural:city?triangles=3", "-o", "a.antumbra"), ["triangles is 3"]),
        ((SCENE,), ["--output"]),
        (("-o", "a.antumbra"), ["SCENE"]),
        (("old.antumbra", "-o", "a.antumbra"), ["old.antumbra", "store"]),
    ],
)
def test_bad_input(cli, tmp_path, given, words):
    cli("build", SCENE, "-o", "old.antumbra", "--quiet")
    cli("build", *given).refused(*words)
    assert [p.name for p in tmp_path.iterdir()] == ["old.antumbra"]


def test_a_store_has_its_own_up_axis(cli):
    cli("build", SCENE, "-o", "a.antumbra", "--quiet")
    cli("info", "a.antumbra", "--up", "z").refused("--up")
    cli("info", SCENE, "--check").refused("--check")
    with open_store("a.antumbra") as store:
        assert store.meta.up == "y"


@pytest.mark.parametrize(
    "text, n",
    [("4G", 4 << 30), ("512M", 512 << 20), ("1.5k", 1536), ("77", 77), ("2 ", 2), ("1GiB", 1 << 30), ("3tb", 3 << 40)],
)
def test_sizes(text, n):
    assert arguments.parse_bytes(text, "x") == n


@pytest.mark.parametrize("text", ["", "G", "-1M", "4X", "1e9", "9" * 50, "99999999T"])
def test_bad_sizes(text):
    with pytest.raises(at.InputError, match="--max-memory"):
        arguments.parse_bytes(text, "--max-memory")


def test_a_mesh_beyond_the_limit_is_refused_unless_it_is_streamed(cli, tmp_path, monkeypatch):
    monkeypatch.setattr("antumbra.formats.format_registry._SOURCE_BYTES", 1 << 30)
    for suffix in ("glb", "ply", "obj"):
        assert cli("scenes", "cellar", "--triangles", "2k", "-o", f"a.{suffix}").code == 0
    told = cli("build", "a.glb", "-o", "b.antumbra", "--max-memory", "1G")
    told.refused("a.glb takes about", "convert it to binary PLY, which is streamed, or raise max_memory")
    assert not (tmp_path / "b.antumbra").exists() and not (tmp_path / "b.parts").exists()
    for suffix in ("ply", "obj"):
        assert cli("build", f"a.{suffix}", "-o", "b.antumbra", "--max-memory", "1G").code == 0
