"""scripts/release: its builds have the same bytes each time, and its checks find what is wrong with a package."""

import base64
import hashlib
import importlib
import json
import os
import re
import shutil
import struct
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from importlib.util import find_spec

import pytest

import antumbra as at
from antumbra.kernels.machine_code import SYSTEMS
from antumbra.kernels.toolchain import kernel_manifest
from antumbra.kernels.toolchain.library_build import LINKERS
from antumbra.store.store_format import VERSION
from antumbra.work.executors import JOB_FORMAT
from antumbra.work.scene_records import FORMAT
from repository import ROOT

sys.path.append(str(ROOT / "scripts"))
PARTS = "build", "checks", "documents", "javascript", "libraries", "trials"
build, checks, documents, javascript, libraries, trials = (importlib.import_module(f"release_{name}") for name in PARTS)
needs_hatchling = pytest.mark.skipif(find_spec("hatchling") is None, reason="no hatchling: builds are NOT checked")


# Builds


def git(folder, *words):
    settings = ["-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false"]
    subprocess.run(["git", *settings, *words], cwd=folder, check=True, capture_output=True)


@pytest.fixture
def tree(tmp_path):
    """A repository with a version and one commit."""
    folder = tmp_path / "tree"
    (folder / "src" / "antumbra").mkdir(parents=True)
    (folder / "src" / "antumbra" / "version.py").write_text('VERSION = "3.2.1"\n')
    git(folder, "init")
    git(folder, "add", ".")
    git(folder, "commit", "-m", "a", "--date", "2020-01-01T00:00:00Z")
    return folder


def test_a_source_has_the_version_and_the_time_of_its_commit(tree, monkeypatch):
    monkeypatch.delenv("SOURCE_DATE_EPOCH", raising=False)
    source = build.read_source(tree, allow_dirty=False)
    assert source.version == "3.2.1" and source.epoch > 1_577_836_800
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "7")
    assert build.read_source(tree, allow_dirty=False).epoch == 7


def test_a_tree_with_changes_is_refused(tree):
    (tree / "new.txt").write_text("a")
    with pytest.raises(build.ReleaseError, match=r"differs from its commit \(\?\? new.txt\); commit, or pass --dirty"):
        build.read_source(tree, allow_dirty=False)
    assert build.read_source(tree, allow_dirty=True).version == "3.2.1"


def test_a_failure_is_one_line():
    with pytest.raises(build.ReleaseError, match=r"^the tool failed with exit code 3: second$") as caught:
        build.run([sys.executable, "-c", "import sys; print('first\\nsecond\\n'); sys.exit(3)"], "the tool")
    assert caught.value.output.startswith("first\n")


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """(the source, the unpacked sdist, the sdist, the pure wheel)."""
    folder = tmp_path_factory.mktemp("release")
    source = build.Source(ROOT, at.__version__, 1_700_000_000)
    sdist = build.build_sdist(source, folder / "sdist")
    unpacked = build.unpack(sdist.path, folder / "unpacked", source)
    return source, unpacked, sdist, build.build_wheel(unpacked, folder / "wheel")


@needs_hatchling
def test_packages_have_the_same_bytes_when_they_are_built_again_elsewhere(built, tmp_path):
    source, unpacked, sdist, wheel = built
    for path in unpacked.root.rglob("*.py"):
        os.utime(path, (1, 1_600_000_000))
    checks.check_same_bytes(sdist.path, build.build_sdist(unpacked, tmp_path / "sdist").path)
    checks.check_same_bytes(wheel.path, build.build_wheel(source, tmp_path / "wheel").path)
    other = build.build_wheel(source._replace(epoch=1_800_000_000), tmp_path / "later").path
    with pytest.raises(build.ReleaseError, match="two builds of it differ"):
        checks.check_same_bytes(wheel.path, other)


@needs_hatchling
def test_built_packages_pass(built):
    for package in built[2:]:
        checks.check_package(package, at.__version__)


# Checks


def digest(data):
    return base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()


def write_wheel(folder, files, tag="py3-none-any", pure="true", record=None):
    """A wheel of antumbra 1.0 with some files. `record` changes the rows of RECORD."""
    info = "antumbra-1.0.dist-info"
    files = files | {f"{info}/WHEEL": f"Wheel-Version: 1.0\nRoot-Is-Purelib: {pure}\nTag: {tag}\n".encode()}
    rows = {name: f"{name},sha256={digest(data)},{len(data)}" for name, data in files.items()}
    rows[f"{info}/RECORD"] = f"{info}/RECORD,,"
    path = folder / f"antumbra-1.0-{tag}.whl"
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
        archive.writestr(f"{info}/RECORD", "\n".join((record or (lambda r: r))(rows).values()))
    return path


CODE = {"antumbra/__init__.py": b"x = 1\n"}


@pytest.mark.parametrize(
    "changes, words",
    [
        ({}, None),
        ({"record": lambda rows: {n: r for n, r in rows.items() if n not in CODE}}, "RECORD and the archive differ in"),
        ({"record": lambda rows: rows | {"more": "more.py,,"}}, "RECORD and the archive differ in more.py"),
        (
            {"record": lambda rows: {n: r.replace(",6", ",7") for n, r in rows.items()}},
            "size or digest of antumbra/__in",
        ),
        ({"record": lambda rows: {n: r.replace("=", "=a", 1) for n, r in rows.items()}}, "another size or digest of"),
        ({"pure": "false"}, "Root-Is-Purelib false"),
        ({"files": CODE | {"antumbra/kernels/libraries/liba.so": b"a"}}, "has the libraries ['liba.so'], not []"),
    ],
)
def test_faults_of_a_pure_wheel(tmp_path, changes, words):
    package = build.Package(write_wheel(tmp_path, **({"files": CODE} | changes)))
    if words is None:
        checks.check_package(package, "1.0")
        with pytest.raises(build.ReleaseError, match=r"should be named antumbra-2.0-py3-none-any.whl"):
            checks.check_package(package, "2.0")
    else:
        with pytest.raises(build.ReleaseError, match=re.escape(words)):
            checks.check_package(package, "1.0")


LIBRARIES, LINUX = "antumbra/kernels/libraries/", "linux-x86_64"
ELFS = [f"{LIBRARIES}libantumbra-{level}.so" for level in SYSTEMS[LINUX].levels]


def listed(kernels, digest="other"):
    return json.dumps({"files": [], "digest": digest, "kernels": kernels}).encode()


def fault(folder, changed):
    """Why a wheel with libraries for Linux cannot be released; files of `changed` with None are left out."""
    tag = build.build_hook().TAGS[LINUX]
    files = CODE | {name: elf(62, b"GLIBC_2.17") for name in ELFS} | {f"{LIBRARIES}kernels.json": listed({})} | changed
    path = write_wheel(folder, {n: d for n, d in files.items() if d}, f"py3-none-{tag}", "false")
    with pytest.raises(build.ReleaseError) as caught:
        checks.check_package(build.Package(path, LINUX), "1.0")
    return str(caught.value)


@needs_hatchling
def test_a_platform_wheel_needs_all_levels_and_libraries_for_its_tag(tmp_path):
    assert "of other sources than those beside them" in fault(tmp_path, {})
    assert "has the libraries" in fault(tmp_path, {ELFS[0]: None})
    assert "it is for manylinux aarch64, not manylinux x86_64" in fault(tmp_path, {ELFS[0]: elf(183, b"")})
    assert "contains the path /home/a/b.py" in fault(tmp_path, {ELFS[0]: elf(62, b"\0/home/a/b.py\0")})


@needs_hatchling
def test_a_platform_wheel_needs_ptx_and_spirv_of_each_kernel_of_devices(tmp_path, monkeypatch):
    monkeypatch.setattr(kernel_manifest, "package_manifest", lambda: kernel_manifest.KernelManifest([], {}, []))
    none = hashlib.blake2b(digest_size=16).hexdigest()
    ptx, spirv, names = (f"{LIBRARIES}devices/{name}" for name in ("k.ptx", "k.spirv", "kernels.json"))
    whole = {
        f"{LIBRARIES}kernels.json": listed({}, none),
        ptx: b"a",
        spirv: b"b",
        names: listed({"k i": ["k", "n"]}, none),
    }
    assert "has no list of the kernels of devices" in fault(tmp_path, whole | {names: None})
    assert "has the device code ['k.ptx', 'kernels.json']" in fault(tmp_path, whole | {spirv: None})
    assert "its device code is of other sources" in fault(tmp_path, whole | {names: listed({"k i": ["k", "n"]})})
    assert "has 1 kernels of devices, not 0" in fault(tmp_path, whole)


@needs_hatchling
def test_a_platform_wheel_needs_the_kernels_of_pages(tmp_path, monkeypatch):
    monkeypatch.setattr(kernel_manifest, "package_manifest", lambda: kernel_manifest.KernelManifest([], {}, []))
    none = hashlib.blake2b(digest_size=16).hexdigest()
    names = [f"{LIBRARIES}kernels.json", f"{LIBRARIES}devices/kernels.json"]
    module, listing = "antumbra/web/kernels/kernels.wasm", "antumbra/web/kernels/kernels.json"
    whole = {name: listed({}, none) for name in names} | {module: b"a", listing: listed({}, none)}
    assert "has ['kernels.json'] for pages" in fault(tmp_path, whole | {module: None})
    assert "kernels.wasm contains the path /home/a.c" in fault(tmp_path, whole | {module: b"\0/home/a.c\0"})
    assert "its kernels of pages are of other sources" in fault(tmp_path, whole | {listing: listed({})})


def test_wheels_have_the_same_sources(tmp_path):
    first = write_wheel(tmp_path, CODE)
    own = {f"antumbra/{name}": b"a" for name in ("kernels/libraries/a.so", "web/kernels/kernels.wasm")}
    second = write_wheel(tmp_path, CODE | own, "py3-none-win_arm64")
    checks.check_same_sources([first, second])
    third = write_wheel(tmp_path, {"antumbra/__init__.py": b"x = 2\n"}, "py3-none-win_amd64")
    with pytest.raises(build.ReleaseError, match=r"win_amd64.whl: its antumbra/__init__.py differs"):
        checks.check_same_sources([first, second, third])


@needs_hatchling
def test_every_system_has_a_tag_and_a_linker():
    assert SYSTEMS.keys() == LINKERS.keys()
    assert build.build_hook().TAGS.keys() == SYSTEMS.keys() - {"wasm32"}  # which has a package of its own


def test_the_package_for_npm_has_the_same_bytes_each_time(tmp_path):
    archives = []
    for name in "first", "second":
        folder = tmp_path / name / "package"
        folder.mkdir(parents=True)
        (folder / "package.json").write_text('{"name": "antumbra", "version": "1.0.0-rc.1"}')
        (folder / "a.mjs").write_text("export const a = 1;")
        archives.append(javascript.pack(folder, folder.parent, 1_700_000_000))
    first, second = archives
    assert first.name == "antumbra-1.0.0-rc.1.tgz"
    assert first.read_bytes() == second.read_bytes()
    with tarfile.open(first) as archive:
        assert archive.getnames() == ["package/a.mjs", "package/package.json"]


# Headers of libraries


def elf(machine, text):
    return b"\x7fELF\x02\x01".ljust(18, b"\0") + struct.pack("<H", machine) + bytes(40) + text


def mach_o(processor, version, signed):
    commands = [struct.pack("<IIII8x", 0x32, 24, 1, version << 16)] + [struct.pack("<II8x", 0x1D, 16)] * signed
    return struct.pack("<III4xI12x", 0xFEEDFACF, processor, 0, len(commands)) + b"".join(commands)


def pe(machine):
    return b"MZ".ljust(0x3C, b"\0") + struct.pack("<I", 0x40) + struct.pack("<4sH", b"PE\0\0", machine)


@pytest.mark.parametrize(
    "data, tag, words",
    [
        (elf(62, b"GLIBC_2.2.5 GLIBC_2.17"), "manylinux_2_17_x86_64", None),
        (elf(183, b"GLIBC_2.17"), "manylinux_2_17_aarch64", None),
        (elf(62, b"GLIBC_2.29"), "manylinux_2_17_x86_64", "needs manylinux 2.29, not 2.17"),
        (elf(62, b""), "manylinux_2_17_aarch64", "for manylinux x86_64"),
        (elf(40, b""), "manylinux_2_17_aarch64", "damaged, or of another processor"),
        (mach_o(0x0100000C, 11, True), "macosx_11_0_arm64", None),
        (mach_o(0x01000007, 11, False), "macosx_11_0_x86_64", None),
        (mach_o(0x0100000C, 11, False), "macosx_11_0_arm64", "no signature"),
        (mach_o(0x0100000C, 14, True), "macosx_11_0_arm64", "needs macosx 14.0, not 11.0"),
        (pe(0x8664), "win_amd64", None),
        (pe(0xAA64), "win_arm64", None),
        (pe(0x8664), "win_arm64", "for win x86_64, not win aarch64"),
        (elf(62, b""), "win_amd64", "for manylinux"),
        (b"\x7fELF\x02\x01", "manylinux_2_17_x86_64", "damaged"),
        (b"text", "win_amd64", "not a shared library"),
        (pe(0x8664), "plan9_x86_64", "unknown"),
    ],
)
def test_libraries_are_for_the_machines_of_the_tag(data, tag, words):
    fault = libraries.header_fault(data, tag)
    assert fault is None if words is None else words in fault


@pytest.mark.slow
@needs_hatchling
@pytest.mark.skipif(find_spec("ziglang") is None, reason="no ziglang: libraries are NOT linked")
@pytest.mark.parametrize("system", [each for each in SYSTEMS if each != "wasm32"])
def test_linked_libraries_are_for_their_tag_only(tmp_path, system):
    (tmp_path / "a.c").write_text("#include <math.h>\ndouble f(double x) { return hypot(x, 1); }\n")
    library = tmp_path / f"a{LINKERS[system].suffix}"
    LINKERS[system].link([], [tmp_path / "a.c"], ["f"], library)
    faults = {tag: libraries.header_fault(library.read_bytes(), tag) for tag in build.build_hook().TAGS.values()}
    assert [tag for tag, fault in faults.items() if fault is None] == [build.build_hook().TAGS[system]]


# Documents


def test_notes_are_the_section_of_the_version():
    text = "# Changes\n\n## 2.0 (unreleased)\n\n- b\n\n### More\n\n- c\n\n## 1.0\n\n- a\n\n## 0.9\n\n## 0.8\n\n- x\n"
    assert documents.release_notes(text, "2.0") == "- b\n\n### More\n\n- c\n"
    assert documents.release_notes(text, "1.0") == "- a\n"
    for missing in "3.0", "0.9", "2":
        with pytest.raises(build.ReleaseError, match=f"no section about {missing}; write one"):
            documents.release_notes(text, missing)
    assert documents.release_notes((ROOT / "CHANGELOG.md").read_text(), at.__version__)


@pytest.mark.skipif(shutil.which("sha256sum") is None, reason="no sha256sum: checksums are NOT checked")
def test_checksums_are_those_of_sha256sum(tmp_path):
    paths = [tmp_path / name for name in "ba"]
    for path in paths:
        path.write_text(path.name)
    (tmp_path / "SHA256SUMS").write_text(documents.checksums(paths))
    done = subprocess.run(["sha256sum", "--check", "SHA256SUMS"], cwd=tmp_path, capture_output=True, text=True)
    assert done.stdout == "a: OK\nb: OK\n"


def test_the_recipe_has_the_version_and_the_digest_of_the_sdist():
    template = (ROOT / "recipe" / "recipe.yaml").read_text()
    recipe = documents.conda_recipe(template, "1.2.3", "ab" * 32)
    assert '  version: "1.2.3"\n' in recipe and f'  sha256: "{"ab" * 32}"\n' in recipe
    with pytest.raises(build.ReleaseError, match="0 lines for the version"):
        documents.conda_recipe("context:\n", "1.2.3", "ab" * 32)


def test_the_recipe_requires_what_the_package_requires():
    def names(requirement):
        return {re.match(r"[\w-]+", line)[0].lower() for line in requirement}

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    run = (ROOT / "recipe" / "recipe.yaml").read_text().partition("  run:\n")[2].partition("\n\n")[0]
    found = names(re.findall(r"- (.+)", run)) - {"python"}
    conda = {"openexr": "openexr-python"}
    required = names([*project["dependencies"], *project["optional-dependencies"]["jit"]])
    assert found == {conda.get(name, name) for name in required}


def test_links_of_llms_txt_lead_to_pages():
    text = (ROOT / "docs" / "llms.txt").read_text()
    links = re.findall(r"\]\(([^)]+)\)", text)
    assert len(links) > 10 and text.startswith("# Antumbra\n\n> ")
    pages = [re.sub(r"^_sources/(.+)\.txt$|^(.+)\.html$", lambda m: m[1] or f"{m[2]}.md", link) for link in links]
    pages.remove("antumbra.md")  # made with the pages
    assert not [page for page in pages if not page.endswith(".md") or not (ROOT / "docs" / page).is_file()]


def test_the_page_of_versions_names_all_formats():
    page = (ROOT / "docs" / "versions.md").read_text()
    rows = {line.split("|")[1].strip(): line.split("|")[2] for line in page.splitlines() if line.startswith("| ")}
    assert f"version {VERSION}" in rows["store, `.antumbra`"]
    assert f"format {FORMAT}" in rows["data set, `manifest.json`"]
    assert f"format {JOB_FORMAT}" in rows["shards, `job.json`"]


@needs_hatchling
def test_the_page_of_installation_names_all_wheels_and_extras():
    page = (ROOT / "docs" / "install.md").read_text()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert not [tag for tag in build.build_hook().TAGS.values() if f"`{tag}`" not in page]
    for_developers = {"build", "release", "view-test", "peers", "all-peers", "opencl-cpu", "docs", "dev"}
    for_developers |= {"test", "test-peers", "test-wasm", "test-all"}
    extras = project["optional-dependencies"].keys() - for_developers
    assert not [extra for extra in extras if f"| `{extra}` |" not in page]
    python = [line.rpartition(" ")[2] for line in project["classifiers"] if re.search(r":: 3\.\d+$", line)]
    assert python[0] == project["requires-python"].removeprefix(">=") and len(python) >= 4


# Trials


def test_pythons_are_listed_once_per_version():
    assert trials.find_pythons([sys.executable]) == [trials.Path(sys.executable)]
    with pytest.raises(build.ReleaseError, match=r"python0.1: no such Python"):
        trials.find_pythons(["python0.1"])


@pytest.mark.slow
@pytest.mark.skipif(find_spec("twine") is None, reason="no twine (antumbra[release]): the whole script is NOT run")
def test_a_release_for_this_system(tmp_path):
    system = build.build_hook().this_system()
    command = [
        ROOT / "scripts" / "release",
        "--dirty",
        "--system",
        system,
        "--out",
        tmp_path,
        "--python",
        sys.executable,
    ]
    subprocess.run([sys.executable, *command], check=True)
    names = sorted(path.name for path in tmp_path.iterdir())
    version = at.__version__
    wheels = [f"antumbra-{version}-py3-none-{tag}.whl" for tag in ("any", build.build_hook().TAGS[system])]
    packages = [f"antumbra-{version}.tar.gz", *wheels]
    assert names == sorted([*packages, f"antumbra-{version}.cdx.json", "SHA256SUMS", "recipe.yaml", "release-notes.md"])
    assert not subprocess.run(["sha256sum", "--check", "--quiet", "SHA256SUMS"], cwd=tmp_path).returncode
