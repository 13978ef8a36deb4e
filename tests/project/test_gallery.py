"""The programs of the docs' gallery run, and the gallery's pictures belong to programs."""

import json
import re
import subprocess
import sys

import pytest
from PIL import Image

from repository import ROOT, tool

sys.path.append(str(ROOT / "scripts"))  # gallery imports snippets
gallery = tool(ROOT / "scripts" / "gallery.py")
pages = tool(ROOT / "scripts" / "pages.py")
PROGRAMS = {program.name: program for program in gallery.programs()}
NEEDS = {"sun_hours": "pvlib", "sun_city": "pvlib", "day": "pvlib", "sun_film": "pvlib"}
NEEDS |= {"ray_hierarchy": "matplotlib", "map_sheet": "matplotlib", "horizon": "matplotlib", "shadow_map": "matplotlib"}
QUICK = {"ray_hierarchy", "horizon", "shadow_map"}  # as they are


@pytest.mark.programs
@pytest.mark.parametrize("name", PROGRAMS)
def test_program_draws_its_picture(name, tmp_path):
    if name in NEEDS:
        pytest.importorskip(NEEDS[name], reason=f"{name} needs {NEEDS[name]}, which is not installed")
    if lacking := gallery.missing(PROGRAMS[name]):
        pytest.skip(f"the picture {name} is NOT tried: {', '.join(lacking)} is not in ANTUMBRA_SCENES")
    text = PROGRAMS[name].path.read_text(encoding="utf-8")
    assert gallery.quick_version(text) != text or name in QUICK
    picture = Image.open(gallery.draw(PROGRAMS[name], tmp_path, quick=True)).convert("RGB")
    assert len(picture.getcolors(1 << 24)) > 20


def test_the_gallery_has_programs_with_titles_captions_and_pictures():
    assert len(PROGRAMS) >= 20
    for program in PROGRAMS.values():
        assert program.title and program.caption.endswith(".") and len(program.code.splitlines()) <= 40, program.name
        assert Image.open(program.picture).width <= gallery.WIDEST
        assert Image.open(program.thumbnail).size == gallery.THUMBNAIL
    kept = {path.stem for path in (gallery.IMAGES / "gallery").rglob("*.webp")}
    assert kept == set(PROGRAMS), "pictures without a program"
    assert sum(path.stat().st_size for path in (gallery.IMAGES / "gallery").rglob("*.webp")) < 6e6


def test_the_gallery_page_shows_all_programs_by_their_titles():
    text = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    shown = re.findall(r"\[!\[([^]]+)\]\(images/gallery/small/(\w+)\.webp\)\]\(gallery/([\w.]+)\)", text)
    assert sorted(shown) == sorted((program.title, name, program.path.name) for name, program in PROGRAMS.items())
    rows = [line.strip("| ").split(" | ") for line in text.splitlines() if line.startswith("| ")]
    for pictures, titles in zip(rows[::2], rows[1::2], strict=True):
        assert [re.match(r"\[!\[([^]]+)", picture)[1] for picture in pictures if picture.strip("| ")] == titles


def test_thumbnails_of_charts_show_a_part_and_those_of_films_the_frame_in_the_middle(tmp_path):
    assert set(gallery.PARTS) <= set(PROGRAMS)
    for name, (left, upper, right, lower) in gallery.PARTS.items():
        assert 0.0 <= left < right <= 1.0 and 0.0 <= upper < lower <= 1.0, name
    wide = Image.new("RGB", (200, 50), "red")
    wide.paste("blue", (190, 0, 200, 50))
    wide.save(tmp_path / "dataset.webp", lossless=True)
    gallery.keep_thumbnail(tmp_path / "dataset.webp", tmp_path / "whole.webp")
    with Image.open(tmp_path / "whole.webp") as whole:
        right, below = (whole.convert("RGB").getpixel(at) for at in ((395, 125), (395, 240)))
    assert right[2] > 200 and below[0] > 200, "all of it, on its own background"
    frames = [Image.new("RGB", (80, 50), colour) for colour in ("black", "red", "white")]
    frames[0].save(tmp_path / "film.webp", save_all=True, append_images=frames[1:], lossless=True)
    gallery.keep_thumbnail(tmp_path / "film.webp", tmp_path / "small.webp")
    assert Image.open(tmp_path / "small.webp").convert("RGB").getpixel((20, 20))[0] > 200
    assert Image.open(tmp_path / "small.webp").convert("RGB").getpixel((20, 20))[1] < 60


def test_what_examples_print_is_kept():
    kept = [example for example in gallery.examples() if example.printed.is_file()]
    assert len(kept) >= 5 and all(example.printed.read_text(encoding="utf-8").strip() for example in kept)
    assert not [example.place for example in gallery.examples() if "examples/" in example.title]


def test_credits_name_scenes_that_programs_use():
    names = {name for program in PROGRAMS.values() for name in program.scenes}
    assert names == set(gallery.CREDITS) == set(gallery.CURES)
    assert all("https://" in cure and "Without it" in cure for cure in gallery.CURES.values())


def test_most_programs_need_no_scenes_from_elsewhere():
    assert sum(bool(program.scenes) for program in PROGRAMS.values()) <= 3


def test_without_scenes_programs_are_skipped_with_a_line(tmp_path):
    command = [sys.executable, ROOT / "scripts" / "gallery.py", "--only", "courtyard", "--output", tmp_path / "out"]
    done = subprocess.run(command, capture_output=True, text=True, env={"ANTUMBRA_SCENES": str(tmp_path)})
    assert done.returncode == 0 and not (tmp_path / "out").exists()
    assert done.stderr == ("courtyard: SKIPPED, sanmiguel_lite is not in ANTUMBRA_SCENES; its old picture stays\n")


# scripts/pages.py


def site(folder, body: str):
    """A site of one page, with an index of the words of `pages.WORDS`."""
    first = pages.search_words.PAGES
    names = sorted({*pages.WORDS.values(), *first.values()})
    index = {
        "docnames": names,
        "terms": {word: names.index(page) for word, page in pages.WORDS.items()},
        "titleterms": {},
        "indexentries": {word: [[names.index(page), "", True]] for word, page in first.items()},
    }
    (folder / "searchindex.js").write_text(f"Search.setIndex({json.dumps(index)})")
    (folder / "page.html").write_text(f'<!doctype html><meta name="viewport" content="width=device-width">{body}')
    return folder


def test_words_that_no_page_has_are_told(tmp_path):
    assert pages.search_faults(site(tmp_path, "")) == []
    empty = {"docnames": ["a"], "terms": {}, "titleterms": {}, "indexentries": {}}
    (tmp_path / "searchindex.js").write_text(f"Search.setIndex({json.dumps(empty)})")
    assert len(pages.search_faults(tmp_path)) == len(pages.WORDS) + len(pages.search_words.PAGES)


def test_pages_that_scroll_sideways_are_told(tmp_path):
    if pages.chromium() is None:
        pytest.skip("no Chromium: the widths of pages are NOT checked")
    site(tmp_path, '<article><p>narrow</p></article><article><div style="width: 500px">wide</div></article>')
    (tmp_path / "good.html").write_text("<!doctype html><article><p>narrow</p></article>")
    lines = pages.faults(pages.check_pages(tmp_path, pages.chromium(), None))
    assert len(lines) == 1 and lines[0].startswith("page.html is ") and "at 390" in lines[0]


HEAD = (
    '<head><title>{}</title><meta name="description" content="{}"><meta property="og:description" content="{}"></head>'
)
TEXT = "Find out exactly which points see which lights, in one sentence."


def test_titles_and_descriptions_that_search_engines_cannot_use_are_told(tmp_path):
    texts = {"a": TEXT, "b": TEXT.upper(), "c": "Short.", "d": f"`Code` {TEXT}", "e": TEXT[:-1], "f": f"Fine. {TEXT}"}
    for name, text in texts.items():
        (tmp_path / f"{name}.html").write_text(HEAD.format("F" if name == "f" else f"A {name != 'e'}", text, text))
    (tmp_path / "none.html").write_text("<head><title>None</title></head>")
    lines = pages.head_faults(tmp_path)
    wrong = [line.partition(" ")[0].removesuffix(".html") for line in lines]
    assert {*wrong} == {"b", "c", "d", "e", "none"}
    assert any("title of a.html" in line for line in lines) and any("description of a.html" in line for line in lines)


def test_the_sitemap_has_all_pages(tmp_path):
    for name in ("a", "b"):
        (tmp_path / f"{name}.html").write_text("")
    (tmp_path / "sitemap.xml").write_text(
        "<loc>https://x.io/antumbra/a.html</loc><loc>https://x.io/antumbra/c.html</loc>"
    )
    assert pages.sitemap_faults(tmp_path) == [
        "sitemap.xml lacks b.html",
        "sitemap.xml lists c.html, which does not exist",
    ]


def test_files_from_other_hosts_are_told(tmp_path):
    own = '<script src="_static/a.js"></script><a href="https://x.io/a.css">link</a><img src="data:image/png;base64,">'
    (tmp_path / "good.html").write_text(own)
    assert pages.host_faults(tmp_path) == []
    for name, tag in enumerate(
        ('<script async src="https://x.io/m.js">', '<link rel="stylesheet" href="https://x.io/a.css">')
    ):
        (tmp_path / f"wrong{name}.html").write_text(own + tag)
    assert [line.partition(" ")[0] for line in pages.host_faults(tmp_path)] == ["wrong0.html", "wrong1.html"]
