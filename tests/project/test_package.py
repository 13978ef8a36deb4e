"""Tests of the whole package: its names, its documents, its files."""

import ast
import doctest
import importlib.metadata
import inspect
import re
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from functools import cache

import pytest

import antumbra as at
from antumbra.base.command_registry import COMMANDS
from antumbra.base.extras import EXTRAS
from antumbra.generate.procedural_scenes import PROCEDURAL
from repository import ROOT, tool

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
SOURCES = sorted((ROOT / "src" / "antumbra").rglob("*.py"))
PAGES = [*ROOT.glob("*.md"), *(p for p in (ROOT / "docs").rglob("*.md") if "_build" not in p.parts)]


fields = tool(ROOT / "docs" / "_ext" / "fields.py")
snippets = tool(ROOT / "scripts" / "snippets.py")


# Names


def test_public_names_are_sorted_and_complete():
    assert at.__all__ == sorted(set(at.__all__))
    assert not [name for name in at.__all__ if not hasattr(at, name)]
    public = {n for n, v in vars(at).items() if not n.startswith("_") and not inspect.ismodule(v)}
    assert public <= set(at.__all__)


REFERENCE = "".join(page.read_text("utf-8") for page in [ROOT / "docs/api.md", *(ROOT / "docs/api").glob("*.md")])


@pytest.mark.parametrize("name", at.__all__)
def test_public_name_is_documented(name):
    thing = getattr(at, name)
    doc = inspect.getdoc(thing) or ""
    assert len(doc) > 20 and doc != inspect.getdoc(thing.__mro__[1] if inspect.isclass(thing) else object)
    assert re.search(rf"::? +antumbra\.{name}\b", REFERENCE)
    if inspect.isclass(thing):
        methods = [m for n, m in vars(thing).items() if not n.startswith("_") and inspect.isroutine(m)]
        assert not [m.__qualname__ for m in methods if not inspect.getdoc(m)]


@pytest.mark.parametrize("name", [n for n in at.__all__ if fields.is_named_tuple(getattr(at, n, None))])
def test_fields_of_a_named_tuple_have_comments(name):
    cls = getattr(at, name)
    comments = fields.field_comments(cls)
    assert tuple(comments) == cls._fields
    assert not [field for field, comment in comments.items() if not comment]
    assert {field: getattr(cls, field).__doc__ for field in cls._fields} == comments  # what help() shows


def test_version():
    assert PROJECT["dynamic"] == ["version"] and "version" not in PROJECT  # it is in version.py only
    assert importlib.metadata.version("antumbra") == at.__version__
    assert f"## {at.__version__}" in (ROOT / "CHANGELOG.md").read_text()


# Imports

NAMES_OF_IMPORTS = {"PIL": "pillow", "imageio_ffmpeg": "imageio-ffmpeg"}
OPTIONAL = {"embreex", "matplotlib", "pvlib", "pandas", "pyproj", "pyarrow", "rasterio", "xatlas", "mitsuba", "open3d"}
OPTIONAL |= {"viser", "websockets", "msgspec", "imageio-ffmpeg", "ray", "DracoPy", "pyvista"}
OPTIONAL |= {"drjit"}  # of mitsuba
OPTIONAL |= {"numba", "llvmlite", "ziglang", "scipy", "OpenEXR", "geopandas", "pyogrio", "shapely"}


def test_import_is_light():
    heavy = {"numpy", "trimesh", "typer", "pydantic", "rich", "PIL", "json", "logging", "imageio_ffmpeg", *OPTIONAL}
    code = f"import sys, antumbra; print(*(m for m in {heavy} if m in sys.modules))"
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert process.stdout.split() == []


def _imports(path):
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield node.module.partition(".")[0]


def test_dependencies_are_those_that_are_imported():
    found = {name for path in SOURCES for name in _imports(path)} - set(sys.stdlib_module_names)
    found = {NAMES_OF_IMPORTS.get(name, name) for name in found - {"antumbra"}}
    declared = {re.match(r"[\w.-]+", line)[0] for line in PROJECT["dependencies"]}
    assert found - OPTIONAL == declared


def test_what_tests_import_is_installed_for_them():
    files = [*(ROOT / "tests").rglob("*.py")]
    found = {name for path in files for name in _imports(path)} - set(sys.stdlib_module_names)
    known = [*files, *(ROOT / "benchmarks").rglob("*.py")]
    ours = {part for path in known for part in path.relative_to(ROOT).with_suffix("").parts}
    found = {NAMES_OF_IMPORTS.get(name, name) for name in found - {"antumbra"} - ours}
    lines = PROJECT["dependencies"] + _requirements("test-all")
    assert found <= {re.match(r"[\w.-]+", line)[0] for line in lines}


def test_extras_for_users_are_explained():
    """In the package, for `antumbra doctor`, and in the documentation; ``all`` includes them all."""
    for_developers = {"release", "build", "view-test", "peers", "all-peers", "opencl-cpu", "docs", "dev"}
    for_developers |= {"test", "test-peers", "test-wasm", "test-all"}
    extras = PROJECT["optional-dependencies"]
    assert EXTRAS.keys() == extras.keys() - for_developers
    assert re.fullmatch(r"antumbra\[(.*)\]", *extras["all"])[1].split(",") == [name for name in EXTRAS if name != "all"]
    tables = [re.findall(r"^\| `(\w+)` \| (.*) \|$", page.read_text(), re.MULTILINE) for page in PAGES]
    assert list(EXTRAS.items()) in tables


def _requirements(extra):
    """The requirements of an extra, and of the extras that it includes: antumbra[sun,gis]."""
    lines = PROJECT["optional-dependencies"][extra]
    included = [name for line in lines for name in re.findall(r"[\w-]+", line.partition("antumbra[")[2])]
    return lines + [more for name in included for more in _requirements(name)]


# Documents


def test_readme_commands_are_one_line_each():
    readme = ROOT / "README.md"
    commands = "".join(snippets.blocks(readme.read_text(), "sh")).splitlines()
    assert commands == [
        "git clone https://github.com/antumbra/antumbra && cd antumbra",
        "python3 -m venv .venv && .venv/bin/pip install '.[jit]' && .venv/bin/antumbra render --size 1280x800",
        "python3 -m venv .venv && .venv/bin/pip install '.[test]' && .venv/bin/pytest",
    ]
    assert snippets.command(readme, "antumbra render --size 1280x800") == commands[1]
    assert snippets.command(readme, "pytest") == commands[2]


def test_docstring_example():
    result = doctest.testmod(at)
    assert result.attempted > 2 and not result.failed


def test_examples_are_short():
    (example,) = snippets.blocks((ROOT / "README.md").read_text(), "python")
    assert len(example.splitlines()) <= 20
    assert len((ROOT / "examples" / "minimal.py").read_text().splitlines()) <= 60


def test_programs_of_pages_keep_their_lines():
    text = "a\n```python\nx = 1\n```\nb\n```sh\nls\n```\n```python\ny = 2\n```\n"
    lines = snippets.program(text).splitlines()
    assert [lines[i] for i in (2, 9)] == ["x = 1", "y = 2"] and len("".join(lines)) == 10


@pytest.mark.parametrize("page", PAGES, ids=lambda p: p.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page):
    text = page.read_text()
    targets = re.findall(r"\]\(([^)#\s]+)[^)]*\)", text) + re.findall(r"\{image\} (\S+)", text)
    local = [t for t in targets if "://" not in t]
    assert not [t for t in local if not (page.parent / t).exists()]


def test_every_page_is_in_a_table_of_contents():
    docs, listed = ROOT / "docs", set()
    pages = {page for page in PAGES if docs in page.parents}
    for page in pages:
        for tree in re.findall(r"^```\{toctree\}\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL):
            listed |= {(page.parent / f"{name}.md").resolve() for name in re.findall(r"^[\w/-]+$", tree, re.MULTILINE)}
            patterns = re.findall(r"^[\w/-]+\*$", tree, re.MULTILINE) if ":glob:" in tree else []
            listed |= {path.resolve() for each in patterns for path in page.parent.glob(f"{each}.md")}
    parts = set((docs / "papers" / "ideas").glob("*.md"))  # included in the pages of papers
    assert pages - listed - parts == {docs / "index.md"} and len(pages) > 30 and len(parts) == 5


def test_every_command_has_its_page():
    process = subprocess.run([sys.executable, "-m", "antumbra", "--help"], capture_output=True, text=True, check=True)
    names = re.findall(r"^  ([a-z][\w-]*)  ", process.stdout, re.MULTILINE)
    assert {*COMMANDS, "bench"} == set(names)
    pages = {name: (ROOT / "docs" / "cli" / f"{name}.md").read_text() for name in names}
    assert not [name for name, page in pages.items() if f"```{{command-help}} {name}" not in page]


_CITED = re.compile(r"\[([A-Z][^\]\n]*?(?:19|20)\d\d[a-z]?)[,\]]")


def _labels():
    """The labels that cite the bibliography: "Wald 2007", "Duff et al. 2017", "Meister and Bittner 2018a"."""
    labels = list(_plain_labels())
    for k, label in enumerate(labels):
        yield label + "abc"[labels[:k].count(label)] * (labels.count(label) > 1)


def _plain_labels():
    bib = (ROOT / "docs" / "REFERENCES.bib").read_text()
    for entry in bib.split("\n@")[1:]:
        names = [n.split()[-1] for n in re.search(r"author\s*= \{(.*)\},\n", entry)[1].split(" and ")]
        who = " and ".join(names) if len(names) < 3 else f"{names[0]} et al."
        yield f"{who} {re.search(r'year *= *{(....)}', entry)[1]}"


def test_cited_works_are_in_the_bibliography():
    labels = set(_labels())
    assert {"Wald 2007", "Keller and Heidrich 2001", "Duff et al. 2017"} <= labels
    pages = {path.name: path.read_text().replace(" & ", " and ") for path in (*SOURCES, *PAGES)}
    cited = {(name, label) for name, text in pages.items() for label in _CITED.findall(text)}
    assert len(cited) > 5
    assert not {(name, label) for name, label in cited if label not in labels}


def test_papers_of_the_registries_are_in_the_bibliography():
    from antumbra.engine.method_registry import KINDS

    labels = set(_labels())
    papers = [method.paper for _, registry in KINDS.values() for method in registry.values()]
    assert papers and not [p for p in papers if p and not any(p.startswith(label) for label in labels)]


_PLACE = re.compile(r"`((?:\w+/)*\w+\.(?:py|md|bib|json|toml))(?:: ([^`]+))?`")


@cache
def _defined(path) -> set[str]:
    """Names of functions, classes, their members, and constants, anywhere in a file."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found.add(node.name)
        if isinstance(node, ast.ClassDef):
            members = [m.name for m in node.body if isinstance(m, ast.FunctionDef)]
            members += [m.target.id for m in node.body if isinstance(m, ast.AnnAssign)]
            members += [m.targets[0].id for m in node.body if isinstance(m, ast.Assign)]
            found |= {f"{node.name}.{member}" for member in members}
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            found.add(node.id)
    return found


MAPS = sorted((ROOT / "src/antumbra/lab/papers").glob("*/README.md"))


@pytest.mark.parametrize("page", MAPS, ids=lambda page: page.parent.name)
def test_what_the_maps_of_papers_name_is_there(page):
    places = _PLACE.findall(page.read_text())
    assert len(places) > 30
    for file, names in places:
        inside = file.partition("/")[0] not in ("benchmarks", "tests", "docs", "scripts", "pyproject.toml")
        path = (ROOT / "src" / "antumbra" if inside else ROOT) / file
        assert path.is_file(), file
        missing = set(names.split(", ")) - _defined(path) if names else set()
        assert not missing, (file, missing)


def test_the_map_of_the_package_is_generated():
    command = [sys.executable, ROOT / "scripts" / "layout.py", "--check"]
    assert subprocess.run(command).returncode == 0, "run scripts/layout.py"


# Files


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    pytest.importorskip("hatchling", reason="no hatchling: the wheel and the sdist are NOT checked")
    folder = tmp_path_factory.mktemp("dist")
    command = [sys.executable, "-m", "hatchling", "build", "-d", str(folder)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    return folder


def test_wheel_is_pure_and_holds_the_package_only(built):
    (wheel,) = built.glob("*.whl")
    assert wheel.name == f"antumbra-{at.__version__}-py3-none-any.whl"
    names = zipfile.ZipFile(wheel).namelist()
    inside = {n for n in names if not n.startswith(f"antumbra-{at.__version__}.dist-info/")}
    package = ROOT / "src" / "antumbra"
    data = [
        package / "kernels" / "needs.json",
        package / "lab/papers/needs.json",
        *package.glob("lab/papers/*/README.md"),
    ]
    data += [package / "py.typed", *(package / "viewer").glob("page.[cm]*s")]
    data += [path for path in package.glob("web/*/*.*") if path.suffix != ".pyc"]
    data += [path for path in (package / "examples").iterdir() if path.suffix not in (".py", "")]
    assert inside == {path.relative_to(ROOT / "src").as_posix() for path in (*SOURCES, *data)}


def test_sdist_holds_what_a_developer_needs(built):
    (sdist,) = built.glob("*.tar.gz")
    with tarfile.open(sdist) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
    wanted = {"README.md", "LICENSE", "CHANGELOG.md", "CONTRIBUTING.md", "pyproject.toml", "tests/oracle.py"}
    wanted |= {"docs/conf.py", "docs/REFERENCES.bib", "examples/minimal.py", "scripts/check"}
    assert wanted <= names
    assert not [n for n in names if "__pycache__" in n or n.startswith("docs/_build")]


def test_procedural_scenes_that_programs_and_pages_name_are_there():
    """Programs that fall back on them do so only where the real scenes are absent."""
    files = [f for kind in ("*.py", "*.md") for folder in ("examples", "docs") for f in (ROOT / folder).rglob(kind)]
    named = {
        name
        for f in files
        if "_build" not in f.parts
        for name in re.findall(r"""procedural\(["'](\w+)["']""", f.read_text())
    }
    assert named and named <= set(PROCEDURAL)
