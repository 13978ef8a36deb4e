"""SECURITY.md, sentence by sentence: the tests that check what it promises."""

import re
import zipfile
from collections.abc import Iterator

import numpy as np
import pytest

import antumbra as at
from antumbra.base.errors import InputError
from antumbra.city.sensors.sensor_files import read_points
from repository import ROOT

TEXT = (ROOT / "SECURITY.md").read_text()

HERE, FUZZ, DOORS = (
    "tests/project/test_security.py",
    "tests/formats/test_format_registry_fuzz.py",
    "tests/project/test_doors.py",
)
GIS, STORE = "tests/city/test_gis_doors.py", "tests/store/test_store_checks.py"
PRIVATE, LIBRARY, GUARD = (
    "tests/kernels/toolchain/test_kernel_cache_private.py",
    "tests/kernels/toolchain/test_kernel_library.py",
    "tests/viewer/test_request_guard.py",
)

PROMISES = {
    "Report it privately": [f"{HERE}::test_reports_go_to_the_page_of_the_project"],
    "Please include the version": [f"{HERE}::test_the_version_is_printed"],
    "A file may be wrong": [f"{FUZZ}::test_damaged_bytes", f"{FUZZ}::test_odd_json_values"],
    "The worst result must be": [
        f"{FUZZ}::test_damaged_bytes",
        f"{FUZZ}::test_damaged_textures",
        f"{GIS}::test_no_raster_reads_files_outside_its_folder_or_addresses",  # one of them holds Python
        f"{HERE}::test_pickles_do_not_run",
    ],
    "Nothing is unpickled": [f"{HERE}::test_pickles_do_not_run", f"{HERE}::test_no_reader_of_files_imports_pickle"],
    "A file cannot name files": [
        f"{GIS}::test_no_raster_reads_files_outside_its_folder_or_addresses",
        f"{GIS}::test_no_vector_file_reads_other_files_or_addresses",
        f"{GIS}::test_the_crs_of_geojson_is_not_fetched",
        "tests/city/gis/test_raster_files.py::test_a_file_that_names_a_raster_at_a_url_does_not_open_it",
        "tests/city/gis/test_raster_files.py::test_nothing_beside_a_raster_at_a_url_is_opened",
        "tests/cli/test_shards.py::test_a_record_of_shards_reaches_no_server",
        "tests/formats/test_mesh_files.py::test_material_files_outside_the_folder_are_not_read",
        "tests/formats/gltf/test_gltf_asset_damaged.py::test_uris_that_leave_the_folder",
    ],
    "Libraries that choose a reader": [
        f"{DOORS}::test_a_library_reads_files_in_its_door_only",
        f"{GIS}::test_descriptions_behind_the_first_bytes_of_a_tiff_are_refused",
    ],
    "Declared sizes are compared": [
        f"{GIS}::test_files_that_expand_are_refused_before_they_do",
        "tests/formats/test_format_registry_cut_text.py::test_lists_of_binary_ply_files_name_their_length",
        "tests/city/sensors/test_sensor_files.py::test_files_that_expand_are_refused_before_they_do",
        f"{HERE}::test_many_primitives_on_one_accessor_are_counted",
        f"{HERE}::test_many_textures_are_counted_before_they_are_decoded",
    ],
    "By default, the limit": [
        "tests/base/test_memory.py::test_a_file_may_take_what_is_available_and_a_multiple_of_its_size",
        "tests/base/test_memory.py::test_max_memory_allows_what_is_refused_otherwise",
        "tests/base/test_memory.py::test_max_memory_of_a_command_limits_reading",
    ],
    "Readers are fuzzed": [f"{FUZZ}::test_every_reader_has_a_seed"],
    "Machine code is loaded from two": [
        f"{LIBRARY}::test_a_library_serves_without_cache_and_compiler",
        f"{LIBRARY}::test_damaged_files_do_not_count",
        f"{HERE}::test_no_variable_names_a_folder_of_libraries",
    ],
    "Code in the cache is loaded": [
        f"{PRIVATE}::test_what_anyone_can_change",
        f"{PRIVATE}::test_what_belongs_to_another_user",
        f"{PRIVATE}::test_folders_of_kernels_that_others_can_change",
    ],
    "Otherwise the process compiles": [f"{PRIVATE}::test_kernels_are_then_compiled_in_a_private_folder"],
    "[Kernels](": [f"{HERE}::test_links_lead_to_pages"],
    "`antumbra view` listens": [
        f"{GUARD}::test_foreign_requests_are_refused",
        f"{HERE}::test_the_viewer_listens_on_this_machine_only",
    ],
    "With `--host`, the address": [f"{GUARD}::test_a_page_for_other_machines_needs_its_token"],
    "Checksums of stores": [
        "tests/kernels/toolchain/test_kernel_cache.py::test_a_record_with_any_byte_changed_is_nothing"
    ],
    "The structure of a store is checked": [
        f"{STORE}::test_forged_counts",
        f"{STORE}::test_forged_nodes_of_a_chunk",
        f"{STORE}::test_forged_metadata",
    ],
    "Plugins are Python packages": ["tests/base/test_extras_plugins.py::test_commands_come_by_name"],
    "Files on PyPI carry": [f"{HERE}::test_the_workflow_of_releases_attests"],
    "`SHA256SUMS` of a release": ["tests/project/test_release.py::test_checksums_are_those_of_sha256sum"],
    "The sdist and the wheels": [
        "tests/project/test_release.py::test_packages_have_the_same_bytes_when_they_are_built_again_elsewhere"
    ],
    "The bill of materials": ["tests/project/test_release.py::test_a_release_for_this_system"],
}
"""Start of a sentence -> the tests of what it promises."""

WARNINGS = [
    "Please do not open", "The latest release gets", "A scene can still be",
    "They run with your rights", "A Ray cluster trusts", "Run it in a network", "Whoever can write",
]  # fmt: skip
"""Starts of sentences that promise nothing: requests, policy, and what is not defended."""


def sentences() -> Iterator[str]:
    """The sentences of SECURITY.md, without headings and the titles of paragraphs."""
    text = re.sub(r"^#.*$|^- (?:\*\*[^*]+\*\*)?", "\n\n", TEXT, flags=re.MULTILINE)
    for paragraph in re.split(r"\n\s*\n", text):
        yield from filter(None, re.split(r"(?<=[.?!]) (?=[A-Z`\[])", " ".join(paragraph.split())))


def test_every_sentence_has_its_tests():
    starts = [*PROMISES, *WARNINGS]
    for sentence in sentences():
        assert sum(sentence.startswith(start) for start in starts) == 1, sentence
    for start in starts:
        assert sum(sentence.startswith(start) for sentence in sentences()) == 1, start


@pytest.mark.parametrize("test", sorted({test for tests in PROMISES.values() for test in tests}))
def test_the_tests_exist(test):
    file, _, name = test.partition("::")
    assert re.search(rf"^def {name}\(", (ROOT / file).read_text(), re.MULTILINE), test


# --- Tests that no other file has -------------------------------------------------------------------------------------


def test_reports_go_to_the_page_of_the_project():
    assert "https://github.com/antumbra/antumbra/security" in TEXT
    assert 'Source = "https://github.com/antumbra/antumbra"' in (ROOT / "pyproject.toml").read_text()


def test_the_version_is_printed(cli):
    told = cli("--version")
    assert (told.code, told.out) == (0, f"antumbra {at.__version__}\n")


class _Trap:
    """An object that would create a file when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return open, (str(self.path), "w")


@pytest.mark.parametrize("name", ["a.npy", "a.npz"])
def test_pickles_do_not_run(tmp_path, name):
    array, path = np.array([_Trap(tmp_path / "ran")] * 3, object), tmp_path / name
    if name == "a.npy":
        np.save(path, array, allow_pickle=True)
    else:
        np.savez(path, x=array, y=array, z=array)
        assert zipfile.is_zipfile(path)
    with pytest.raises(InputError, match="only plain numbers are read"):
        read_points(path)
    (tmp_path / "frames").mkdir()
    np.save(tmp_path / "frames" / "frames.npy", array, allow_pickle=True)
    np.save(tmp_path / "frames" / "faces.npy", np.zeros((1, 3), int))
    with pytest.raises(InputError):
        at.load(tmp_path / "frames")
    assert not (tmp_path / "ran").exists()


def test_no_reader_of_files_imports_pickle():
    for folder in ("formats", "scene", "store", "jobs"):
        for path in (ROOT / "src" / "antumbra" / folder).rglob("*.py"):
            assert not re.search(r"^\s*(import|from) (pickle|marshal|shelve|dill)|allow_pickle=True", path.read_text(),
                                 re.MULTILINE), path  # fmt: skip


def test_many_primitives_on_one_accessor_are_counted(tmp_path):
    from gltf_files import Gltf

    made = Gltf()
    points = made.accessor(np.random.default_rng(0).random((3000, 3)).astype(np.float32))
    mesh = made.add("meshes", primitives=[{"attributes": {"POSITION": points}}] * 20_000)
    made.node(mesh=mesh)
    (tmp_path / "a.glb").write_bytes(made.glb())
    with pytest.raises(InputError, match=r"meshes\[0\] and what precedes it takes about .* raise max_memory"):
        at.load(tmp_path / "a.glb")


@pytest.mark.parametrize("suffix", [".glb", ".obj"])
def test_many_textures_are_counted_before_they_are_decoded(tmp_path, suffix):
    import io

    from PIL import Image

    from gltf_files import Gltf

    stream, made = io.BytesIO(), Gltf()
    Image.new("L", (2000, 2000)).save(stream, "PNG")
    points = made.accessor(np.eye(3, dtype=np.float32))
    lines, n = ["v 0 0 0", "v 1 0 0", "v 0 1 0", "vt 0 0", "mtllib a.mtl"], 80
    for k in range(n):
        image = stream.getvalue() + k.to_bytes(1, "little")  # equal ones are decoded once
        texture = made.add("textures", source=made.add("images", bufferView=made.view(image)))
        look = {"baseColorTexture": {"index": texture}}
        material = made.add("materials", pbrMetallicRoughness=look)
        primitive = {"attributes": {"POSITION": points, "TEXCOORD_0": points}, "material": material}
        made.node(mesh=made.add("meshes", primitives=[primitive]))
        (tmp_path / f"{k}.png").write_bytes(image)
        lines += [f"usemtl m{k}", "f 1/1 2/1 3/1"]
    (tmp_path / "a.mtl").write_text("".join(f"newmtl m{k}\nmap_Kd {k}.png\n" for k in range(n)))
    (tmp_path / f"a{suffix}").write_bytes(made.glb() if suffix == ".glb" else "\n".join(lines).encode())
    with pytest.raises(InputError, match=f"a{suffix}: its textures takes? about 1.9 GB of memory, .* raise max_memory"):
        at.load(tmp_path / f"a{suffix}")


def test_no_variable_names_a_folder_of_libraries():
    """Variables that name folders or files are those of the cache and of results."""
    read = set()
    for path in (ROOT / "src" / "antumbra").rglob("*.py"):
        read |= set(re.findall(r"ANTUMBRA_[A-Z_]+", path.read_text()))
    assert "ANTUMBRA_CACHE" in read
    assert not {name for name in read if re.search("LIB|KERNEL|MODULE|PLUGIN", name)}


def test_links_lead_to_pages():
    links = re.findall(r"\]\(([^)]+)\)", TEXT)
    assert len(links) >= 2 and all((ROOT / link).is_file() for link in links)
    names = [name for name in re.findall(r"`(tests/[^`]+)`", TEXT)]
    assert len(names) >= 2 and all((ROOT / name).is_file() for name in names)


def test_the_viewer_listens_on_this_machine_only():
    import inspect

    assert inspect.signature(at.view).parameters["host"].default in ("127.0.0.1", "localhost")


@pytest.mark.skipif(not (ROOT / ".github").exists(), reason="an sdist has no workflows: NOT checked")
def test_the_workflow_of_releases_attests():
    text = (ROOT / ".github" / "workflows" / "release.yml").read_text()
    assert "pypa/gh-action-pypi-publish" in text and "id-token: write" in text and "attestations: false" not in text
