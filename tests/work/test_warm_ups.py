"""Records hold the kernels that example calls run. The tests find kernels that grow."""

import json
import re
import subprocess
import sys

import pytest

from antumbra.engine import precompilation
from antumbra.engine.plan import Plan, covering_plans, parse_plan
from antumbra.engine.plan_records import kernels_of_plan, precompile_plan
from antumbra.engine.precompilation import missing_of, precompile
from antumbra.kernels.marshalling import import_object
from antumbra.kernels.toolchain import kernel_manifest
from antumbra.kernels.toolchain.compile_pool import KernelRequest
from antumbra.work import warm_ups
from repository import ROOT

NAMES = [example.name for example in warm_ups.all_examples(papers=True)]
CALLED = """
import json, sys
from antumbra.kernels.toolchain.kernel_loading import events
from antumbra.work.warm_ups import all_examples

told = {}
for example in all_examples(papers=True):
    if example.name in sys.argv[1:]:
        before = len(events)
        example.call()
        told[example.name] = [(event.kernel, event.key) for event in events[before:]]
print(json.dumps(told))
"""


def test_examples_are_recorded():
    assert set(NAMES) == set(kernel_manifest.recorded_kernels().jobs)
    assert len(NAMES) == len(set(NAMES)) and not [
        name for name in NAMES if not kernel_manifest.kernels_of_warm_up(name)
    ]


def test_sources_name_examples_that_exist():
    """A misspelt name would compile nothing ahead of time, without an error."""
    sources = [path.read_text() for path in (ROOT / "src").rglob("*.py")]
    calls = re.compile(r'\b(?:precompile|is_compiled|kernels_of_warm_up)\("([^"]+)"')
    used = {name for source in sources for name in calls.findall(source)}
    assert len(used) > 15 and used <= set(NAMES)


@pytest.fixture
def compiled(monkeypatch):
    """The kernels that are compiled, while none is on disk. None is compiled."""
    kernels = []
    monkeypatch.setattr(precompilation, "is_on_disk", lambda kernel, key: False)
    monkeypatch.setattr(
        precompilation, "compile_kernels", lambda missing, progress, levels=None: kernels.extend(missing)
    )
    precompile.cache_clear()
    precompile_plan.cache_clear()
    yield kernels
    precompile.cache_clear()
    precompile_plan.cache_clear()


def test_the_kernels_of_an_example_are_compiled_once(compiled):
    precompile("ray queries")
    precompile("ray queries")
    assert len(compiled) > 10 and set(compiled) == kernel_manifest.kernels_of_warm_up("ray queries")


def test_only_plans_without_a_record_need_an_example_frame(compiled):
    assert not precompile_plan(Plan(), "raster")
    assert set(compiled) == missing_of(kernels_of_plan(Plan(), "raster", False))
    assert precompile_plan(parse_plan("grid32+lbvh+packet16"), "raster")


def test_no_example_frame_is_needed_once_all_kernels_are_on_disk(compiled, monkeypatch):
    monkeypatch.setattr(precompilation, "is_on_disk", lambda kernel, key: True)
    assert not precompile_plan(parse_plan("grid32+lbvh+packet16"), "raster") and not compiled


def test_recorded_kernels_exist():
    kernels = kernel_manifest.recorded_kernels().kernels
    assert len(kernels) > 100 and not [each for each in kernels if not callable(import_object(each.kernel))]


OWN = [example.name for example in warm_ups.all_examples()]
PARTS = [OWN[i::3] for i in range(3)]
PARTS += [pytest.param([name for name in NAMES if name not in OWN], marks=pytest.mark.papers)]


def test_libraries_have_the_kernels_of_all_methods_once():
    packed = [(each.kernel, each.key) for each in kernel_manifest.package_manifest().kernels]
    assert set(packed) == {(each.kernel, each.key) for each in kernel_manifest.recorded_kernels().kernels}
    assert len(set(packed)) == len(packed) > len(kernel_manifest.read_manifests(kernel_manifest.MANIFEST).kernels)


@pytest.mark.parametrize("names", PARTS)
def test_examples_call_what_is_recorded(names):
    done = subprocess.run([sys.executable, "-c", CALLED, *names], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert list(told) == [name for name in NAMES if name in names]
    missing = {
        name: [f"{kernel} {key}" for kernel, key in called if (kernel, key) not in known]
        for name, called in told.items()
        for known in [{(each.kernel, each.key) for each in kernel_manifest.kernels_of_warm_up(name)}]
    }
    missing = {name: kernels for name, kernels in missing.items() if kernels}
    assert not missing, f"run scripts/record_kernels.py: {missing}"


def test_a_plan_that_nobody_recorded_is_put_together():
    plan = parse_plan("grid32+lbvh+packet16")
    assert str(plan) not in {str(p) for p in covering_plans(papers=True)}
    found = kernels_of_plan(plan, "raster", False)
    names = {each.kernel.partition(":")[0].removeprefix("antumbra.") for each in found}
    assert {"bvh.lbvh", "techniques.culling.pre_bvh_culling", "trace.packets.packet16"} <= names
    assert found < {each for name in NAMES for each in kernel_manifest.kernels_of_warm_up(name)}
    assert kernels_of_plan(Plan(), "raster", False) == kernel_manifest.kernels_of_warm_up("bsah+multifrusta (raster)")


def test_the_size_of_kernels_is_as_recorded(capsys):
    """Lowers three kernels and compares their sizes. ``scripts/record_kernels.py`` measures all kernels again."""
    from antumbra.kernels.toolchain import compiling

    said = json.loads(kernel_manifest.MANIFEST.read_text())["kernels"]
    rows = [row for row in said if row[0].endswith(("_shade_rows", "place", "_move_kernel"))]
    assert len(rows) >= 3
    for name, key, size in rows:
        now = compiling.size_of(compiling.lower_kernel(import_object(name), key, "measured")[0])
        with capsys.disabled():
            print(f"\n{name}: {now.functions} functions, {now.instructions} instructions; recorded: {size}", end="")
        assert now.functions <= size["functions"] * 1.05 + 1 and now.instructions <= size["instructions"] * 1.05 + 20


@pytest.mark.parametrize(
    "name, kernels, functions, instructions",
    [("auto (raster)", 55, 1583, 74_800), ("bsah+multifrusta (raster)", 33, 1115, 54_700)],
    ids=["the default plan", "the first picture"],
)
def test_what_every_user_compiles_stays_within_its_budget(capsys, name, kernels, functions, instructions):
    """A change that needs a larger budget states the reason in docs/design/kernels.md."""
    job = json.loads(kernel_manifest.MANIFEST.read_text())
    sizes = [job["kernels"][i][2] for i in job["jobs"][name]]
    total = {each: round(sum(size[each] for size in sizes), 1) for each in ("functions", "instructions", "seconds")}
    with capsys.disabled():
        print(f"\n{name}: {len(sizes)} kernels, {total}", end="")
    assert len(sizes) <= kernels and total["functions"] <= functions and total["instructions"] <= instructions


def test_a_record_of_other_sources_is_no_error():
    """A developer renames a kernel or a type, and runs a job before its kernels are recorded again."""
    kernel, key = "antumbra.bvh.lbvh:no_such_kernel", "A[i8,1,C] antumbra.bvh.nodes:NoSuchType( i )"
    real = next(iter(kernel_manifest.read_manifests(kernel_manifest.MANIFEST).kernels))
    requests = [KernelRequest(kernel, "i"), KernelRequest(real.kernel, key), KernelRequest("antumbra.none:f", "i")]
    requests += [KernelRequest(real.kernel, f"{real.key} i")]  # a parameter less since then
    assert missing_of(requests) == set()
