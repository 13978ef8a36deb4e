"""Rules with --before and --per: verdicts compare the states, as separate runs and the texts of the rules say."""

import csv
import json

import numpy as np
import pytest

import antumbra as at

pytest.importorskip("pvlib", reason="needs pvlib, so verdicts of both states are NOT checked")
pytest.importorskip("geopandas", reason="needs geopandas, so verdicts of both states are NOT checked")

CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
TURNS = {"straight": 0, "turned": 1}  # quarters, counterclockwise
SUNSHINE = "62/78/115/169/199/204/212/205/149/117/73/52"
RULES = "br209-vsc", "br209-apsh", "din5034-winter", "din5034-equinox", "en17037-minimum", "en17037-high"
WORST = "br209-vsc", "br209-apsh"  # a dwelling passes with all of its windows
WINDOWS = [  # id, dwelling, x, y, z: on the south wall of the houses
    *(("w1", "ground floor", 2, 0, 1.5), ("w2", "ground floor", 18, 0, 1.5), ("w3", "attic", 2, 0, 8.5)),
    *(("w4", "attic", 18, 0, 8.5), ("w5", "far", 160, 0, 2.0), ("w6", "far", 175, 0, 2.0)),
]


def turned(points, quarters):
    points = np.asarray(points, float)
    return [points, points[..., [1, 0, 2]] * (-1, 1, 1)][quarters]


def put_boxes(path, boxes, quarters):
    """An OBJ file of boxes, (low, size) each."""
    lines = []
    for k, (low, size) in enumerate(boxes):
        lines += [f"v {x:g} {y:g} {z:g}" for x, y, z in turned(low + CUBE * size, quarters).tolist()]
        lines += ["f " + " ".join(str(8 * k + 1 + i) for i in quad) for quad in QUADS]
    path.write_text("\n".join(lines) + "\n")


@pytest.fixture(params=TURNS)
def site(request, tmp_path):
    """Arguments of `sun`: houses with windows, a wall before one of them, and a tower planned opposite others."""
    quarters = TURNS[request.param]
    low = [[0.0, 0.05, 0.0], [165.0, -6.0, 0.0], [-20.0, -40.0, -0.5]]
    sizes = [[200.0, 8.0, 10.0], [20.0, 2.0, 6.0], [240.0, 60.0, 0.5]]
    put_boxes(tmp_path / "site.obj", list(zip(np.array(low), np.array(sizes))), quarters)
    put_boxes(tmp_path / "tower.obj", [(np.zeros(3), np.array([18.0, 10.0, 48.0]))], quarters)
    at_tower = turned([-6.0, -26.0, 0.0], quarters)
    normal = turned([0.0, -1.0, 0.0], quarters)
    rows = [[*names, *turned(place, quarters), *normal] for *names, x, y, z in WINDOWS for place in [(x, y, z)]]
    text = [["id", "dwelling", "x", "y", "z", "nx", "ny", "nz"], *rows]
    (tmp_path / "windows.csv").write_text("\n".join(",".join(map(str, row)) for row in text) + "\n")
    scene = "sun", "site.obj", "--up", "z", "--latitude", 51.5, "--longitude", -0.1, "--timezone", "UTC"
    change = "--add", f"tower.obj?up=z&at={','.join(f'{x:g}' for x in at_tower)}"
    return (*scene, "--north", -90 * quarters, "--quiet"), change


def rows_of(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def numbers(rows, name):
    return np.array([float(row[name]) if row[name] else np.nan for row in rows])


def flags(rows, name):
    return np.array([row[name] == "True" for row in rows])


def judged(rule, before, after):
    """Verdicts of a rule on windows, from its text."""
    if rule == "br209-vsc":
        former, now = numbers(before, "br209_vsc"), numbers(after, "br209_vsc")
        return (now >= 27.0) | (now >= 0.8 * former)
    if rule == "br209-apsh":
        (former, now), (former_winter, winter) = (
            (numbers(before, name), numbers(after, name)) for name in ("br209_apsh", "br209_apsh_winter")
        )
        enough = (now >= 25.0) & (winter >= 5.0)
        return enough | ((now >= 0.8 * former) & (winter >= 0.8 * former_winter)) | (former - now <= 4.0)
    least = {"din5034-winter": 1.0, "din5034-equinox": 4.0, "en17037-minimum": 1.5, "en17037-high": 4.0}[rule]
    column = "en17037_hours" if rule.startswith("en") else rule.replace("-", "_") + "_hours"
    return numbers(after, column) >= least - 1e-9


ALL_RULES = [word for rule in RULES for word in ("--rule", rule)]
STUDY = *ALL_RULES, "--sunshine", SUNSHINE, "--lowest", 10, "--sensors", "windows.csv"


@pytest.fixture
def separate(cli, tmp_path, site):
    """The windows in a run without the tower, and in one with it."""
    scene, change = site
    cli(*scene, *STUDY, "-o", "without.csv")
    cli(*scene, *change, *STUDY, "-o", "with.csv")
    return rows_of(tmp_path / "without.csv"), rows_of(tmp_path / "with.csv")


def test_windows_are_judged_by_both_states_of_separate_runs(cli, tmp_path, site, separate):
    scene, change = site
    before, after = separate
    cli(*scene, *change, *STUDY, "--before", "-o", "both.csv")
    both = rows_of(tmp_path / "both.csv")
    assert [row["id"] for row in both] == [row["id"] for row in after] == [name for name, *_ in WINDOWS]
    quantities = [name for name in after[0] if name.startswith(("br209", "din", "en")) and "passes" not in name]
    assert len(quantities) == 6  # three of BR 209, and one of each day
    for name in quantities:
        assert numbers(both, name + "_before").tolist() == numbers(before, name).tolist()
        assert numbers(both, name).tolist() == numbers(after, name).tolist()
        assert numbers(both, name + "_loss").tolist() == (numbers(before, name) - numbers(after, name)).tolist()
    for rule in RULES:
        verdict = flags(both, rule.replace("-", "_") + "_passes")
        assert verdict.tolist() == judged(rule, before, after).tolist()
    compared, alone = (flags(rows, "br209_vsc_passes") for rows in (both, after))
    assert (compared & ~alone).any() and not compared.all()  # what remains decides for some


def test_dwellings_are_judged_by_their_windows_in_both_states(cli, tmp_path, site, separate):
    scene, change = site
    before, after = separate
    cli(*scene, *change, *STUDY, "--before", "--per", "dwelling", "-o", "homes.csv")
    homes = rows_of(tmp_path / "homes.csv")
    dwelling = [row["dwelling"] for row in after]
    names = list(dict.fromkeys(dwelling))
    assert [row["dwelling"] for row in homes] == names
    for rule in RULES:
        windows = judged(rule, before, after)
        of_each = [windows[[each == name for each in dwelling]] for name in names]
        expected = [bool(each.all() if rule in WORST else each.any()) for each in of_each]
        prefix = rule.replace("-", "_")
        assert flags(homes, prefix + "_passes").tolist() == expected
        assert numbers(homes, prefix + "_share").tolist() == [each.mean() for each in of_each]
    worst = [numbers(before, "br209_vsc")[[each == name for each in dwelling]].min() for name in names]
    assert numbers(homes, "br209_vsc_before").tolist() == worst
    first = [name for name in homes[0] if name.startswith("br209_vsc")]
    assert first == [f"br209_vsc{end}" for end in ("_passes", "_ratio", "_share", "_loss", "_before", "")]


def test_every_format_has_the_verdicts(cli, tmp_path, site):
    scene, change = site
    study = "--rule", "br209-vsc", "--rule", "en17037-minimum", "--lowest", 10, "--sensors", "windows.csv"
    files = [f"homes.{suffix}" for suffix in ("csv", "json", "npz", "parquet", "gpkg", "glb", "png")]
    outputs = [word for name in files for word in ("-o", name)]
    cli(*scene, "--crs", "EPSG:27700", *change, *study, "--before", "--per", "dwelling", *outputs)
    assert all((tmp_path / name).exists() for name in files)
    expected = [row["br209_vsc_passes"] == "True" for row in rows_of(tmp_path / "homes.csv")]
    assert True in expected and False in expected
    rows = json.loads((tmp_path / "homes.json").read_text())["rows"]
    assert rows["br209_vsc_passes"] == expected and rows["dwelling"] == ["ground floor", "attic", "far"]
    with np.load(tmp_path / "homes.npz") as arrays:
        assert arrays["br209_vsc_passes"].tolist() == expected
    geopandas = pytest.importorskip("geopandas")
    for name, read in (("homes.parquet", geopandas.read_parquet), ("homes.gpkg", geopandas.read_file)):
        table = read(tmp_path / name)
        assert table["br209_vsc_passes"].astype(bool).tolist() == expected
        assert table["dwelling"].tolist() == ["ground floor", "attic", "far"]


def test_shards_of_both_states_are_judged_after_they_are_merged(cli, tmp_path, site):
    scene, change = site
    study = (*scene, *change, *STUDY, "--before", "--per", "dwelling")
    cli(*study, "-o", "one.csv")
    for k in range(2):
        cli(*study, "-o", "two.csv", "--shard", f"{k}/2")
    cli("merge", "two.shards", "--quiet")
    assert (tmp_path / "two.csv").read_bytes() == (tmp_path / "one.csv").read_bytes()


def test_python_gives_the_same_verdicts_as_the_command(cli, site, tmp_path):
    scene, change = site
    study = "--rule", "br209-vsc", "--rule", "en17037-minimum", "--lowest", 10, "--sensors", "windows.csv"
    cli(*scene, *change, *study, "--before", "--per", "dwelling", "-o", "homes.csv")
    homes = rows_of(tmp_path / "homes.csv")
    bare = at.load(tmp_path / "site.obj", up="z")
    offset = tuple(float(x) for x in change[1].partition("at=")[2].split(","))
    tower = at.load(tmp_path / "tower.obj", up="z")
    place = at.Place(51.5, -0.1, 0.0, float(scene[scene.index("--north") + 1]), "UTC")
    table = at.scene_change(bare, add=[(tower, offset)]).compare(
        at.sun_hours, str(tmp_path / "windows.csv"), place=place, rule=["br209-vsc", "en17037-minimum"], lowest=10.0,
        per="dwelling",
    )  # fmt: skip
    assert next(iter(table.columns)) == "br209_vsc_passes"
    for name in ("br209_vsc_passes", "en17037_minimum_passes"):
        assert table[name].tolist() == flags(homes, name).tolist()
