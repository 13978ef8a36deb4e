"""The pages of the documentation: their length, their figures, examples of all functions, and generated parts."""

import inspect
import json
import re
import shlex
import sys
from collections import namedtuple

import pytest

import antumbra as at
from antumbra.base.command_registry import COMMANDS
from repository import ROOT, tool

sys.path.append(str(ROOT / "scripts"))  # figures_page imports document_numbers
DOCS = ROOT / "docs"
words = tool(ROOT / "scripts" / "document_words.py")
figures = tool(ROOT / "scripts" / "figures_page.py")
snippets = tool(ROOT / "scripts" / "snippets.py")


# Words


def test_hand_written_pages_are_short():
    pages = words.pages()
    assert {"README.md", "index.md", "sun.md"} <= {page.name for page in pages} and len(pages) > 30
    assert 10_000 < sum(words.words(page.read_text(encoding="utf-8")) for page in pages) <= words.MOST


def test_words_are_those_that_a_reader_reads():
    text = "Two words.\n```python\nno = 'word'\n```\n| [three](a/b.md) | 4.5 |\n|---|---|\nfive<!-- x: 6 -->\n"
    assert words.words(text) == 5


# Figures


def test_the_page_of_figures_is_generated():
    assert figures.page() == figures.PAGE.read_text(encoding="utf-8"), "run scripts/figures_page.py"


def test_the_page_of_figures_calls_scenes_by_readable_names():
    assert figures.readable("Delft: delft_city, not_delft_city") == "Delft: Delft, not_delft_city"
    assert figures.legend("| Robots | 1 |\n| method | Sponza |") == (
        "Scenes and their files: Robots (`bart_robots`), Sponza (`sponza_crytek`).\n"
    )
    shown = [line for line in figures.page().splitlines() if line.startswith(("|", "<summary>"))]
    assert not [line for line in shown if any(file in line for file in figures.SCENES)]


def test_each_table_of_figures_has_its_command_machine_and_date():
    sections = re.findall(r"^<details(?: open)?>\n<summary>.*?^</details>$", figures.page(), re.M | re.S)
    assert len(sections) > 25 and len(re.findall(r"^\|[-:]", figures.page(), re.M)) == len(sections)
    sources = [re.findall(r"^`(?:python|antumbra|pytest) [^`]+`: .+; \d{4}-\d\d-\d\d\.$", s, re.M) for s in sections]
    assert [len(found) for found in sources] == [1] * len(sections)


def test_bars_follow_their_numbers_and_those_of_ratios_below_one_are_grey():
    about = {"command": "x", "date": "2026-01-02", "processor": "a Zen"}
    made = figures.table("T", about, ["a", "ratio"], [["b", "2.00"], ["c", "0.50"]], [figures.Bars(["ratio"], True)])
    assert '| b | 2.00 <span class="bar" style="width:100%"></span> |' in made and "|---|---|" in made
    assert '| c | 0.50 <span class="bar below" style="width:25%"></span> |' in made


def test_rows_without_a_match_are_an_error():
    with pytest.raises(LookupError, match="no rows"):
        figures.where([{"scene": "a"}], scene="b")


MACHINE = {"command": "python benchmarks/x.py", "date": "2026-01-02", "processor": "a Zen", "threads": 1}
ARRAYS = [
    {"scene": scene, "kind": "random", "rays": 1000, "method": method, "we_are_faster": ratio}
    for scene, method, ratio in [
        ("a", "occluded", 1.0),
        ("a", "embree 1 medium", 2.0),
        ("a", "embree 16 high", 1.5),
        ("a", "embreex", 4.0),
        ("b", "occluded", 1.0),
        ("b", "embree 1 medium", 0.5),
        ("b", "open3d", 3.0),
    ]
]
AUTO = [{"scene": "a", "seconds": s} for s in ({"auto": 2.0, "x": 1.0, "y": 4.0}, {"auto": 3.0, "x": 3.0, "y": 3.0})]
SMALL = [
    {"scene": "a", "light": "small", "family": family, "mrays": rate}
    for family, rate in (("antumbra", 16.04), ("embree", 3.0), ("embree", 15.0), ("open3d", 3.3))
]
RADIOMETRY = [
    {"case": "point", "lit": 0.002, "penumbra": {}},
    {"case": "quad", "lit": 0.026, "penumbra": {"256": 1.02, "4096": 0.06}},
    {"case": "daylight", "count": 256, "relative": 4.7},
    {"case": "sun", "count": 256, "relative": 3.66},
]
JOBS = [
    {"what": "matrix", "scene": "a", "points": 1000, "seconds": 0.5},
    {"what": "bake", "scene": "b", "points": 500, "rays": 2_000_000, "seconds": 0.04},
    {"what": "viewer", "scene": "a", "triangles": 1234, "step": "full size", "seconds": 0.254},
    {"what": "viewer", "scene": "b", "triangles": 99, "step": "full size", "seconds": 1.0},
]
STORE = {"what": "store", "triangles": 5_000_000, "bytes": 4e8, "build": 30.2, "first": 3, "later": 0.8, "peak": 2e9}
NODES = [
    {"hours": 1.0, "store": store, "nodes": 8, "seconds": seconds, "of_ideal": share}
    for store, seconds, share in ((0.0, 459.2, 0.98), (4.0, 1491.0, 0.92))
]


@pytest.mark.parametrize(
    "title, results, row",
    [
        ("Soft shadows in small images", {"rows": SMALL}, "| a | small | 16.0 | 15.0 | 3.3 |"),
        ("Arrays of rays", {"rows": ARRAYS}, "| random | 1,000 | 0.50 to 1.50 | 4.00 to 4.00 | 3.00 to 3.00 |"),
        ("Method selection by `auto`", {"rows": AUTO}, "| `auto` | 1.41 | 2.00 |\n| `x` | 1.00 | 1.00 |"),
        ("Irradiance", {"rows": RADIOMETRY}, "| point | 0.002 % | none | none |\n| quad | 0.026 % | 1.02 % | 0.06 % |"),
        ("Skies", {"rows": RADIOMETRY, "size": 32}, "| 256 | 4.7 % | 3.7 % |"),
        ("Jobs", {"rows": JOBS}, "| baking 500 vertices of b, 2.0 million rays | 0.0 | 80 s a million vertices |"),
        ("Images of the viewer", {"rows": JOBS}, "| full size | 0.25 | 1.00 |"),
        ("A store of", {"rows": [STORE]}, "| building | 30 s | a file of 0.4 GB |"),
        (
            "Nodes of a cluster",
            {"rows": [{"parts": [0.5, 1.5]}], "simulated": NODES, "about": MACHINE},
            "| 1 h | 8 | 459, 0.98 | 1,491, 0.92 |",
        ),
    ],
)
def test_newer_results_replace_transcribed_tables(title, results, row, tmp_path, monkeypatch):
    part, name, _ = figures.RERUN[title]
    older = {"part": part, "title": f"{title}: older", "columns": ["a"], "rows": [["1"]], **MACHINE}
    other = {**older, "title": "Another table"}
    (tmp_path / "transcribed.json").write_text(json.dumps({"tables": [older, other]}))
    assert len(list(figures.transcribed(part))) >= 2
    (tmp_path / f"{name}.json").write_text(json.dumps({"machine": MACHINE, **results}))
    monkeypatch.setattr(figures, "RESULTS", tmp_path)
    monkeypatch.setattr(figures, "RERUN", {title: figures.RERUN[title]})
    made, left = (re.sub(r" <span.*?</span>", "", each) for each in figures.transcribed(part))
    heading = re.sub("`(.*)`", r"<code>\1</code>", title)
    assert row in made and f"<summary>{heading}" in made and "<summary>Another table</summary>" in left
    assert "`python benchmarks/x.py`: a Zen; 1 thread; 2026-01-02." in made


def test_wrong_elsewhere_has_the_kept_results():
    page = (DOCS / "wrong-elsewhere.md").read_text(encoding="utf-8")
    rows = json.loads((DOCS / "results" / "wrong_elsewhere.json").read_text())["rows"]
    shown = [line.strip("|").split(" | ") for line in page.splitlines() if line.startswith("| ") and " · " in line]
    counts = {cells[0].partition(" (of")[0].strip(): cells[1:] for cells in shown}
    assert len(rows) > 10 and {row["case"] for row in rows} == set(counts)
    for row in rows:
        cells = [cell.replace("·", "0").replace(",", "") for cell in counts[row["case"]]]
        assert list(map(int, cells)) == [*row["wrong"].values()]


# Reference


def test_every_function_has_an_example():
    """In Python blocks of pages, which scripts/check runs; except the viewer's, which waits for a browser."""
    code = "".join(snippets.program(page.read_text(encoding="utf-8")) for page in DOCS.glob("*.md"))
    reference = [page.read_text(encoding="utf-8") for page in (DOCS / "api").glob("*.md")]
    code += "".join(snippets.program(text) + "".join(snippets.blocks(text, "py")) for text in reference)
    functions = [name for name in at.__all__ if inspect.isfunction(getattr(at, name))]
    assert len(functions) > 25
    assert [name for name in functions if not re.search(rf"\bat\.{name}\(", code)] == []


@pytest.fixture
def extension(monkeypatch):
    """Imports an extension of Sphinx from docs/_ext/."""
    pytest.importorskip("docutils", reason="no docutils: generated parts of pages are NOT checked")
    monkeypatch.setattr(sys, "path", [str(DOCS / "_ext"), str(ROOT / "scripts"), *sys.path])
    return lambda name: tool(DOCS / "_ext" / f"{name}.py")


def test_the_summary_of_a_name_is_its_first_sentence(extension):
    pytest.importorskip("sphinx", reason="summaries of the reference are NOT checked without Sphinx")
    summary = extension("api_summary")
    assert summary.summary_of("antumbra.Scene.update") == "Move the geometry."
    assert "\n" not in summary.summary_of("antumbra.Scene")
    entry = lambda page, kind: namedtuple("Entry", "docname node_id objtype aliased")(page, "", kind, False)
    objects = {
        "antumbra.Scene.update": entry("api/scene", "method"),
        "antumbra.Scene": entry("api/scene", "class"),
        "antumbra.load": entry("api/load", "function"),
        "antumbra.integrations.open3d.RaycastingScene": entry("api/open3d", "class"),
    }
    names = summary.names_of(objects, ["api/load", "api/scene"])
    assert names == ["antumbra.load", "antumbra.Scene.update", "antumbra.Scene"]
    assert [summary.short(name, objects) for name in objects] == [
        "at.Scene.update",
        "at.Scene",
        "at.load",
        "RaycastingScene",
    ]


def test_the_summary_of_a_result_is_without_its_type(extension):
    pytest.importorskip("sphinx", reason="summaries of the reference are NOT checked without Sphinx")
    summary = extension("api_summary")
    assert summary.summary_of("antumbra.Hit.mask") == "Whether the ray hits a face."
    assert summary.summary_of("antumbra.Sky.radiance").startswith("Linear radiance along directions")
    assert summary.summary_of("antumbra.integrations.open3d.RaycastingScene.INVALID_ID") == "Constant, 4294967295."


def test_parameters_that_a_function_describes_are_not_repeated(extension):
    shared = extension("shared_keywords")
    for name, other in shared.DESCRIBED.items():
        lines, whole = shared.docstring_of(name), shared.parameters(shared.docstring_of(other))
        before = shared.parameters(lines)
        shared.refer(None, "class", name, None, None, lines)
        after = shared.parameters(lines)
        (sentence,) = [line for line in lines if line.endswith(f"described at `{other}`.")]
        gone = {each for names in before.keys() - after.keys() for each in names.split(", ")}
        assert gone == set(re.findall(r"\*(\w+)\*", sentence)) and len(gone) > 5
        assert before.keys() - after.keys() <= whole.keys() and "Raises" in lines


def test_fields_are_a_name_a_type_and_a_text(extension):
    nodes = pytest.importorskip("docutils.nodes", reason="fields are NOT checked without docutils")
    page = pytest.importorskip("docutils.utils").new_document("page")
    parts = nodes.strong("", "points"), nodes.Text(" ("), nodes.emphasis("", "(n, 3) float"), nodes.Text(")")
    field = nodes.paragraph("", "", *parts, nodes.Text(" -- "), nodes.Text("World (not local)."))
    bare = nodes.paragraph("", "", nodes.strong("", "a"), nodes.Text(" ("), nodes.Text("int"), nodes.Text(")"))
    page += nodes.field_list("", nodes.field("", nodes.field_name("", "x"), nodes.field_body("", field, bare)))
    names = [nodes.list_item("", field.deepcopy()) for _ in range(3)]
    for item, name in zip(names, "abc"):
        item[0][0].replace_self(nodes.strong("", name))
    entries = nodes.bullet_list("", *names, nodes.list_item("", bare.deepcopy()))
    page += nodes.field_list("", nodes.field("", nodes.field_name("", "y"), nodes.field_body("", entries)))
    extension("fields")._separate(None, page)
    shown = [item.astext() for item in entries]
    assert shown == ["a, b, c : (n, 3) float \N{EN DASH} World (not local).", "a : int"]
    assert field.astext() == "points : (n, 3) float \N{EN DASH} World (not local)." and bare.astext() == "a : int"


def test_pages_are_described_by_their_first_sentences(extension):
    pytest.importorskip("sphinx", reason="descriptions of pages are NOT checked without Sphinx")
    nodes = pytest.importorskip("docutils.nodes")
    results = extension("search_results")
    page = pytest.importorskip("docutils.utils").new_document("page")
    page += [
        nodes.figure("", nodes.caption("", "A picture."), nodes.legend("", nodes.paragraph("", "In a figure."))),
        nodes.paragraph("", "It traces 1.5 rays, e.g. two. "),
        nodes.paragraph("", f"They are exact. {'Long ' * 40}end."),
    ]
    assert results.of_text(page) == "It traces 1.5 rays, e.g. two. They are exact."
    assert results.of_command("sun").startswith("antumbra sun: Compute sun hours on surfaces. ")


def test_written_descriptions_are_of_pages_and_fit(extension):
    pytest.importorskip("sphinx", reason="descriptions of pages are NOT checked without Sphinx")
    results = extension("search_results")
    assert len(results.SENTENCES) > 40 and len({*results.SENTENCES.values()}) == len(results.SENTENCES)
    for page, text in results.SENTENCES.items():
        assert any((DOCS / f"{page}{suffix}").is_file() for suffix in (".md", ".ipynb")), page
        assert results.SHORTEST <= len(text) <= results.LONGEST and text.endswith(".") and "`" not in text, page


def test_charts_are_told_from_pictures_by_their_white_ground(extension):
    charts = extension("charts")
    kinds = {path.name: charts.kind_of(path) for path in (DOCS / "papers").iterdir() if path.suffix in (".png", ".svg")}
    assert kinds["srdh-comparison.png"] == kinds["srdh.svg"] == "chart"
    assert kinds["pre-bvh-culling-figure3.png"] is None and charts.kind_of(DOCS / "images" / "view.png") is None
    assert {"chart", "sheet", None} == set(kinds.values())


def test_diagrams_of_two_halves_are_two_parts(extension):
    charts = extension("charts")
    assert [
        name for name in ("srdh", "chc-rt", "pre-bvh-culling") if charts.has_halves(DOCS / "papers" / f"{name}.svg")
    ] == [
        "srdh",
        "chc-rt",
    ]
    left, right = charts.halves(charts.nodes.image(uri="a.svg", alt="Two trees", classes=["chart"]))
    assert (left[0]["alt"], right[0]["alt"], right[0]["uri"]) == ("Two trees", "", "a.svg")


def test_only_the_group_of_the_page_is_open_in_the_sidebar(extension):
    group = '<p class="caption" role="heading"><span>{}</span></p>\n<ul{}><li>x</li></ul>\n'
    folded = extension("sidebar").folded
    tree = folded(group.format("A", "") + group.format("B", ' class="current"') + group.format("C", ""))
    assert re.findall(r"<details( open)?><summary class=\"caption\"><span>(\w)</span></summary><ul", tree) == [
        ("", "A"),
        (" open", "B"),
        ("", "C"),
    ]
    assert tree.count("</ul>") == tree.count("</details>") == 3 and "<p" not in tree
    first = folded(group.format("A", "") + group.format("B", ""))
    assert first.index("<details open>") < first.index("<details><")


def test_a_notebook_is_a_page_with_its_output(extension):
    pytest.importorskip("myst_parser", reason="the pages of notebooks are NOT checked without myst-parser")
    name = "shadows.ipynb"
    page = extension("notebooks").page_of(json.loads((DOCS / "notebooks" / name).read_text(encoding="utf-8")), name)
    assert page.startswith("# Shadows as arrays\n") and "```python\n" in page and page.count("data:image/png") >= 4
    assert "[Open in Colab](https://colab" in page and f"{{download}}`download {name} <{name}>`" in page
    assert "badge.svg" not in page and "((360, 480, 1), dtype('uint64'))" in page


def test_errors_on_the_page_are_raised(extension):
    raised = extension("raised")
    lines = (DOCS / "errors.md").read_text(encoding="utf-8").partition("```{raised}\n")[2].partition("```")[0]
    rows = raised.rows_of(lines.splitlines())
    assert len(rows) > 15 and all(all(row) for row in rows)
    with pytest.raises(ValueError, match="raises no InputError"):
        raised.message("at.procedural('atrium')")


def test_generated_tables_list_the_registries(extension):
    registries = extension("registries")
    assert {"`.glb`", "`.antumbra` `.tiles`"} <= {row[1] for row in registries.format_rows()}
    assert {"`bsah`", "`multifrusta`", "`auto`"} <= {row[0] for row in registries.method_rows()}


def test_all_pages_in_one_file_write_out_what_is_generated(extension):
    pages = [
        (
            "a",
            "# A\n```{image} x.png\n:alt: A cat\n```\n![A dog](y.png)\n<!-- no -->\n```python\nx = 1\n```\n"
            "[B](b.md), {func}`at.f`\n",
        ),
        (
            "b",
            "```{command-help} plans\n```\n```{eval-rst}\n.. autoclass:: antumbra.Place\n```\n```{toctree}\na\n```\n",
        ),
    ]
    text = extension("whole").whole(pages)
    assert "[B](b.md), `at.f`" in text and "antumbra.Place(latitude, longitude, " in text
    assert "(Picture: A cat)" in text and "(Picture: A dog)" in text and "x = 1" in text and "<!-- no -->" not in text
    assert "Usage: antumbra plans" in text and "latitude" in text and "{" not in text.partition("b.html")[0]
    assert text.index("<!-- a.html -->") < text.index("<!-- b.html -->")


def test_pages_linked_from_the_readme_are_plain_markdown():
    """They are also read without the site, which alone knows directives, roles and links without a text."""
    linked = sorted(set(re.findall(r"\]\((docs/[\w/-]+\.md)", (ROOT / "README.md").read_text(encoding="utf-8"))))
    assert len(linked) > 15
    for page in [ROOT / name for name in linked]:
        text = page.read_text(encoding="utf-8")
        assert not re.search(r"\[\]\(|^`{3,}\{|^:{3,}|\{[a-z:]+\}`", text, re.MULTILINE), page


@pytest.mark.parametrize("page", sorted(path.stem for path in (DOCS / "jobs").glob("*.md") if path.stem != "cluster"))
def test_job_pages_begin_with_a_picture_and_the_work_as_a_command_and_in_python(page):
    """The two blocks in a row are tabs on the site. (`cluster` is about all jobs.)"""
    text = (DOCS / "jobs" / f"{page}.md").read_text(encoding="utf-8")
    pairs = re.findall(r"^```sh\nantumbra .*?^```\n\n```(?:python|py)\nimport antumbra as at$", text, re.M | re.S)
    first = text.index("```sh\n")
    title, picture, sentence = text[:first].strip().split("\n\n")
    assert pairs and title.startswith("# ") and picture.startswith(("![", "```{live} ")) and "```" not in sentence


PAGE = """# Page

```python
from PIL import Image

Image.new("RGB", (8, 8), "red").save("red.png")
print(f"{1 + 1} in {0.5} s")
```

```text
2 in 7.0 s
```

![Red](images/blocks/red.webp)

```python
print(3)
```

```text
4
```
"""


def test_results_that_a_page_shows_are_those_of_its_blocks(tmp_path, capsys):
    """Times may differ, as may pictures by less than a shade."""
    page = tmp_path / "page.md"
    page.write_text(PAGE)
    stale = snippets.run([page], lambda block: block.language == "python")
    assert [each.removeprefix(f"{page}:") for each in stale] == [
        "3: draws another picture than images/blocks/red.webp",
        "16: prints\n3\n",
    ]
    assert page.read_text() == PAGE and snippets.run([page], lambda _: False, store=True) == []
    assert snippets.run([page], lambda block: block.language == "python", store=True) == []
    assert page.read_text() == PAGE.replace("7.0 s", "0.5 s").replace("\n4\n", "\n3\n")
    assert snippets.run([page], lambda block: block.language == "python") == []


def test_the_first_pages_show_what_their_blocks_print():
    pages = [DOCS / f"{name}.md" for name in ("quickstart", "tutorials/pictures", "tutorials/rays")]
    every = [(page, block) for page in pages for block in snippets.page_blocks(page.read_text(encoding="utf-8"))]
    printing = [block for _, block in every if "print(" in block.code]
    assert len(printing) > 10 and [block.code for block in printing if not (block.printed and block.printed[1])] == []
    pictures = [page.parent / block.picture[1] for page, block in every if block.picture]
    assert len(pictures) >= 4 and all(each.is_file() for each in pictures)


def test_the_quick_start_has_the_first_picture_and_the_first_answer_within_a_screen_each():
    sections = (DOCS / "quickstart.md").read_text(encoding="utf-8").split("\n## ")[1:]
    assert [section.partition("\n")[0] for section in sections] == [
        "Install",
        "The first picture",
        "The first answer in Python",
        "Next",
    ]
    assert max(section.count("\n") for section in sections) <= 25


def test_each_public_name_is_on_one_page_of_the_reference():
    """A page has one class, or a few functions with the classes that they return."""
    pattern = r"^\.\. auto(?:function|class|exception):: antumbra\.(\w+)(?:\(\))?$"
    pages = {page: re.findall(pattern, page.read_text(encoding="utf-8"), re.M) for page in (DOCS / "api").glob("*.md")}
    every = [name for names in pages.values() for name in names]
    errors = re.findall(r"autoexception:: antumbra\.(\w+)", (DOCS / "api.md").read_text(encoding="utf-8"))
    assert sorted([*every, *errors]) == sorted({*at.__all__} - {"cluster", "examples"})
    assert len(pages) > 30 and max(map(len, pages.values())) <= 9


def test_help_is_parted_into_names_and_texts(extension):
    pytest.importorskip("sphinx", reason="the pages of commands are NOT checked without Sphinx")
    shown = extension("help")
    lines = ["  --a FILE  Long.  [default: b]", "  --much-longer NAME", "      Next line.", "  -q, --quiet  Hush."]
    assert shown.records_of(lines) == [
        ("--a FILE", "Long.  [default: b]"),
        ("--much-longer NAME", "Next line."),
        ("-q, --quiet", "Hush."),
    ]
    options = shown.help_text("sun").partition("\nOptions:\n")[2].partition("\n\n")[0]
    records = dict(shown.records_of(options.split("\n")))
    assert len(records) > 15 and all(records.values()) and records["--energy"].startswith("Add the direct energy")


def test_pages_of_commands_begin_with_examples_and_main_options(extension):
    pytest.importorskip("sphinx", reason="the pages of commands are NOT checked without Sphinx")
    shown = extension("help")
    first, details, last = shown.ordered(shown.help_text("render").split("\n\n")[1:])
    assert first[0] == "  Render SCENE with exact shadows."
    assert first[1].split("\n")[:2] == ["  Examples", "    antumbra render"] and first[1].count("\n") == 2
    titles = [part.partition(":")[0] for part in first if not part.startswith(" ")]
    assert titles == ["Arguments", "Picture", "Light", "Output"]
    assert [part.split("\n")[0].strip() for part in details if "\n" in part] == ["CAMERA", "LIGHT", "More examples"]
    assert last and not any(part.startswith((" ", *titles)) for part in last)
    for name in COMMANDS:
        parts = shown.help_text(name).split("\n\n")[1:]
        lines = [line for group in shown.ordered(parts) for part in group for line in part.split("\n")]
        more = "  More examples"
        assert sorted({*lines} - {more}) == sorted({line for part in parts for line in part.split("\n")}), name


def test_long_signatures_are_folded_and_examples_follow_the_summary(extension):
    addnodes = pytest.importorskip("sphinx.addnodes", reason="signatures are NOT checked without Sphinx")
    nodes = pytest.importorskip("docutils.nodes")
    first = extension("examples_first")
    parameter = lambda name: addnodes.desc_parameter("", "", addnodes.desc_sig_name("", name), nodes.Text(": int"))
    only = addnodes.desc_parameter("", "", addnodes.desc_sig_operator("", "*"))

    def signature(*children):
        return addnodes.desc_signature("", "", addnodes.desc_parameterlist("", "", *children))

    short, long = signature(*map(parameter, "abcdef")), signature(*map(parameter, "ab"), only, *map(parameter, "cdefg"))
    for each in (short, long):
        first.shorten(each)
    assert len(short) == 1 and "is_multiline" not in short
    line, opens, whole, closes = long.children
    assert [each.astext() for each in line[0]] == ["a", "b", "*", "…"] and line["add_permalink"]
    assert "all 7 parameters" in opens.astext() and len(whole) == 8 and closes.astext() == "</details>"

    text = lambda word: nodes.paragraph("", word)
    content = addnodes.desc_content(
        "",
        text("summary"),
        text("more"),
        nodes.field_list(),
        nodes.rubric("", "Examples"),
        text("example"),
        addnodes.desc(),
    )
    first.move_examples(content)
    assert [node.astext() for node in content] == ["summary", "example", "more", "", ""]


def test_each_program_of_the_gallery_is_a_page(extension):
    pytest.importorskip("myst_parser", reason="the pages of the gallery are NOT checked without myst-parser")
    pictures = extension("pictures")
    programs = {each.name: each for each in pictures.gallery.programs()}
    page = pictures.page_of(programs["first"])
    assert page.startswith("# The first picture\n\n![The first picture](../images/gallery/first.webp)")
    assert "```sh\nantumbra render" in page and "Scene: `procedural:atrium` [comes with the package]" in page
    assert "San Miguel by Guillermo" in pictures.page_of(programs["courtyard"])
    assert all(pictures.page_of(each).endswith(f"{{download}}`{each.path.name}`\n") for each in programs.values())


def test_comments_are_left_out_of_pages(extension):
    nodes = pytest.importorskip("docutils.nodes", reason="comments are NOT checked without docutils")
    page = pytest.importorskip("docutils.utils").new_document("page")
    page += nodes.paragraph("", "", nodes.Text("7"), nodes.raw("", "<!-- x: 7 -->", format="html"))
    page += nodes.raw("", "<details>", format="html")
    extension("comments").drop_comments(None, page)
    assert page.astext() == "7\n\n<details>"


def test_fields_of_the_reference_have_dashes(extension):
    nodes = pytest.importorskip("docutils.nodes", reason="fields are NOT checked without docutils")
    page = pytest.importorskip("docutils.utils").new_document("page")
    parts = [nodes.strong("", "step"), nodes.Text(" -- "), nodes.Text("Minutes, as by --step -- or as the rule says.")]
    body = nodes.field_body("", nodes.paragraph("", "", *parts))
    page += [
        nodes.field_list("", nodes.field("", nodes.field_name("", "Parameters"), body)),
        nodes.paragraph("", " -- "),
    ]
    extension("fields")._separate(None, page)
    assert page.astext().splitlines()[2] == "step \N{EN DASH} Minutes, as by --step -- or as the rule says."
    assert page.children[1].astext() == " -- "


def test_a_command_and_the_python_after_it_become_tabs(extension):
    nodes = pytest.importorskip("docutils.nodes", reason="tabs are NOT checked without docutils")
    pytest.importorskip("sphinx_design", reason="tabs are NOT checked without sphinx-design")
    new_document = pytest.importorskip("docutils.utils").new_document

    page = new_document("page")
    kinds = ["python", "sh", "python", "sh", "text", "python", "sh"]
    blocks = [nodes.literal_block("", f"{k}", language=kind) for k, kind in enumerate(kinds)]
    words = nodes.paragraph("", "between")
    page += [*blocks[:3], words, *blocks[3:]]
    extension("code_tabs").join_blocks(None, page)
    tabs = [node for node in page.children if isinstance(node, nodes.container)]
    assert [tab.astext().split() for tab in tabs] == [["Command", "line", "1", "Python", "2"]]
    assert [node.astext() for node in page.children if node is not tabs[0]] == ["0", "between", "3", "4", "5", "6"]


def test_shell_blocks_in_a_row_with_labels_become_tabs(extension):
    nodes = pytest.importorskip("docutils.nodes", reason="tabs are NOT checked without docutils")
    pytest.importorskip("sphinx_design", reason="tabs are NOT checked without sphinx-design")
    page = pytest.importorskip("docutils.utils").new_document("page")
    codes = [("sh", "# Clone\ngit x"), ("sh", "# pip, once released\npip y"), ("python", "z"), ("sh", "w")]
    page += [nodes.literal_block(code, code, language=kind) for kind, code in codes]
    extension("code_tabs").join_blocks(None, page)
    (tabs,) = [node for node in page.children if isinstance(node, nodes.container)]
    labels = [(label.astext(), label["sync_group"]) for label in tabs.findall(nodes.rubric)]
    assert labels == [("Clone", "ways"), ("pip, once released", "ways")]
    assert [block.rawsource for block in page.findall(nodes.literal_block)] == ["git x", "pip y", "z", "w"]


@pytest.mark.parametrize("page", ["index", "install", "quickstart"])
def test_the_first_pages_begin_with_the_ways_to_install(page):
    first, second = snippets.blocks((DOCS / f"{page}.md").read_text(encoding="utf-8"), "sh")[:2]
    assert first.startswith("# Clone\ngit clone ") and second == "# pip, once released\npip install antumbra\n"


def test_long_tables_of_papers_fold_below_their_titles(extension):
    nodes = pytest.importorskip("docutils.nodes", reason="folds are NOT checked without docutils")
    folds = extension("folds")
    page = pytest.importorskip("docutils.utils").new_document("page")
    table = lambda rows: extension("registries").table(["a"], [["1"]] * rows)
    title = lambda text: nodes.paragraph("", "", nodes.Text(""), nodes.strong("", text), nodes.Text(""))
    measured = nodes.section("", nodes.title("", "How"), nodes.paragraph("", "by x"), ids=[folds.MEASURED])
    results = nodes.section(
        "", title("Long <1>"), table(20), title("Short"), table(3), nodes.paragraph("", "b"), table(20)
    )
    page += [measured, results]
    settings = type("App", (), {"env": type("Env", (), {"docname": "papers/x"})})
    folds.fold_page(settings, page)
    raw = [node.astext() for node in page.findall(nodes.raw)]
    assert raw[0::2] == [
        "<details><summary>Command, machine, dates and load</summary>",
        "<details><summary>Long &lt;1&gt;</summary>",
    ]
    assert raw[1::2] == ["</details>"] * 2 and len(list(page.findall(nodes.table))) == 3
    assert [node.astext() for node in page.findall(nodes.strong)] == ["Short"]


@pytest.mark.parametrize(
    "name, parts",
    [
        ("Scene.occluded", ["tmin: numpy.typing.ArrayLike = 0.0", "targets: numpy.typing.ArrayLike | None = None"]),
        (
            "render",
            [
                "scene: SceneLike",
                "camera: antumbra.Camera | None = None",
                "progress: collections.abc.Callable",
                "-> antumbra.Frame",
            ],
        ),
        ("Place", ["latitude: float", "timezone: str | None"]),
    ],
)
def test_types_in_signatures_are_short_and_public(extension, name, parts):
    pytest.importorskip("sphinx", reason="signatures are NOT checked without Sphinx")
    signatures, thing = extension("signatures"), at
    for part in name.split("."):
        thing = getattr(thing, part)
    kind = "class" if inspect.isclass(thing) else "method" if "." in name else "function"
    shown, result = signatures.add_types(None, kind, name, thing, None, "()", None)
    assert [part for part in parts if part not in f"{shown} -> {result}"] == [] and "self" not in shown
    assert signatures.add_types(None, "property", name, thing, None, "()", None) is None


def test_stored_inventories_have_the_types_of_signatures(extension):
    """Sites of other libraries are not read when the pages are built."""
    inventory = pytest.importorskip("sphinx.util.inventory", reason="inventories are NOT checked without Sphinx")
    signatures, known = extension("signatures"), set()
    files = sorted((DOCS / "_inventories").glob("*.txt"))
    for file in files:
        known |= {
            name for names in inventory.InventoryFile.loads(file.read_bytes(), uri="").data.values() for name in names
        }
    assert len(files) >= 5 and {"trimesh.Trimesh", "pyvista.PolyData", "ValueError"} <= known
    assert {*signatures.PLACES.values(), *signatures.BUILTIN} - known == set()


def test_long_commands_break_before_options_and_remain_the_same_command(extension):
    broken = extension("long_commands").broken
    long = (
        'antumbra sun "procedural:city?triangles=100k" --latitude 52 --sheet title="A - b" --days 2026-06-21 -o a.tif'
    )
    lines = broken(long).splitlines()
    assert len(lines) == 2 and max(map(len, lines)) <= 86 and lines[1].startswith("    --")
    assert shlex.split(broken(long).replace("\\\n", "")) == shlex.split(long)
    assert broken("antumbra render") == "antumbra render" and broken(f"{long}  # why") == f"{long}  # why"


def test_options_and_dates_of_commands_stay_whole_on_narrow_screens(extension):
    keep = extension("long_commands").keep_whole
    shell = '<div class="highlight-sh notranslate"><pre>a --step <span class="m">2026</span>-03-21 {}</pre></div>'
    end, next_line = "\n", '<span class="w">    </span>'
    page = keep(shell.format(f'<span class="se">\\</span>{end}{next_line}b &#39;c-d&#39; {"e-" * 40}') + "<p>f-g</p>")
    assert page.count('<span class="line">') == 1  # the command goes on in its second line
    assert re.findall('<span class="whole">(.*?)</span>', page) == ["--step", "-03-21", "&#39;c-d&#39;"]
    assert f'<span class="continued"><span class="se">\\</span>{end}{next_line}</span>b' in page
    assert page.endswith("<p>f-g</p>")
    assert keep('<span class="pre">--up</span>') == '<span class="pre whole">--up</span>'
    assert keep(f'<span class="pre">{"g" * 40}</span>') == f'<span class="pre">{"g" * 40}</span>'


def test_links_have_texts():
    for page in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]:
        assert "_build" in page.parts or "[](" not in page.read_text(encoding="utf-8"), page
