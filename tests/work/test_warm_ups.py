"""Recorded jobs have the kernels that they call. The tests find kernels that grow."""

import json
import subprocess
import sys

import pytest

from antumbra.engine.plan import Plan, covering_plans, parse_plan
from antumbra.engine.precompilation import missing_of
from antumbra.kernels.marshalling import import_object
from antumbra.kernels.toolchain import kernel_manifest
from antumbra.kernels.toolchain.compile_pool import KernelRequest
from antumbra.picture.render_kernels import rendering_warm_up
from antumbra.work import warm_ups

NAMES = [job.name for job in warm_ups.all_warm_ups(papers=True)]
CALLED = """
import json, sys
from antumbra.kernels.toolchain.kernel_loading import events
from antumbra.work.warm_ups import all_warm_ups

told = {}
for job in all_warm_ups(papers=True):
    if job.name in sys.argv[1:]:
        before = len(events)
        job.work()
        told[job.name] = [(event.kernel, event.key) for event in events[before:]]
print(json.dumps(told))
"""


def test_jobs_are_recorded():
    assert set(NAMES) == set(kernel_manifest.recorded_kernels().jobs)
    assert len(NAMES) == len(set(NAMES)) and not [
        name for name in NAMES if not kernel_manifest.kernels_of_warm_up(name)
    ]


def test_recorded_kernels_exist():
    kernels = kernel_manifest.recorded_kernels().kernels
    assert len(kernels) > 100 and not [each for each in kernels if not callable(import_object(each.kernel))]


OWN = [job.name for job in warm_ups.all_warm_ups()]
PARTS = [OWN[i::3] for i in range(3)]
PARTS += [pytest.param([name for name in NAMES if name not in OWN], marks=pytest.mark.papers)]


def test_libraries_have_the_kernels_of_all_methods_once():
    packed = [(each.kernel, each.key) for each in kernel_manifest.package_manifest().kernels]
    assert set(packed) == {(each.kernel, each.key) for each in kernel_manifest.recorded_kernels().kernels}
    assert len(set(packed)) == len(packed) > len(kernel_manifest.read_manifests(kernel_manifest.MANIFEST).kernels)


@pytest.mark.parametrize("names", PARTS)
def test_jobs_call_what_is_recorded(names):
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
    found = rendering_warm_up(plan).kernels()
    names = {each.kernel.partition(":")[0].removeprefix("antumbra.") for each in found}
    assert {"bvh.lbvh", "techniques.culling.pre_bvh_culling", "trace.packets.packet16"} <= names
    assert found < {each for name in NAMES for each in kernel_manifest.kernels_of_warm_up(name)}
    assert rendering_warm_up(Plan()).kernels() == kernel_manifest.kernels_of_warm_up("bsah+multifrusta (raster)")


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


def test_the_default_plan_stays_within_its_budget(capsys):
    """The kernels of the default plan stay small, because every user compiles them.

    A change that needs a larger budget states the reason in docs/design/kernels.md.
    """
    job = json.loads(kernel_manifest.MANIFEST.read_text())
    sizes = [job["kernels"][i][2] for i in job["jobs"]["auto (raster)"]]
    total = {name: round(sum(size[name] for size in sizes), 1) for name in ("functions", "instructions", "seconds")}
    with capsys.disabled():
        print(f"\nauto (raster): {len(sizes)} kernels, {total}", end="")
    assert len(sizes) <= 60 and total["functions"] <= 1800 and total["instructions"] <= 85_000


def test_a_record_of_other_sources_is_no_error():
    """A developer renames a kernel or a type, and runs a job before its kernels are recorded again."""
    kernel, key = "antumbra.bvh.lbvh:no_such_kernel", "A[i8,1,C] antumbra.bvh.nodes:NoSuchType( i )"
    real = next(iter(kernel_manifest.read_manifests(kernel_manifest.MANIFEST).kernels))
    requests = [KernelRequest(kernel, "i"), KernelRequest(real.kernel, key), KernelRequest("antumbra.none:f", "i")]
    assert missing_of(requests) == set()
