"""Records the kernels of example calls, with their sizes, in src/antumbra/kernels/needs.json and papers/needs.json.
The first file also lists the kernels of devices.

python scripts/record_kernels.py [--check] [--only TEXT]

Each call is made in its own process, so that it loads every kernel that it needs. --check writes nothing: it lists
called kernels that are missing from the files, and exits with code 1 if there are any. --only makes the calls with TEXT
in their names and keeps the records of the others.
"""

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from antumbra.kernels.toolchain.kernel_manifest import MANIFEST, recorded_kernels
from antumbra.lab.papers.published_methods import NEEDS as PAPERS
from antumbra.work.warm_ups import all_examples

JOB = """
import json, sys
from antumbra.kernels.toolchain.kernel_loading import events
from antumbra.work.warm_ups import all_examples

all_examples(papers=True)[int(sys.argv[1])].call()
print(json.dumps(sorted({(event.kernel, event.key) for event in events})))
"""
MEASURE = """
import json, sys
from antumbra.kernels.toolchain.compile_pool import import_numba
import_numba()
from time import process_time
from antumbra.kernels.machine_code import emit_object, optimise
from antumbra.kernels.processor import level
from antumbra.kernels.marshalling import import_object
from antumbra.kernels.toolchain import compiling

for name, key in json.load(sys.stdin):
    start = process_time()
    module, _ = compiling.lower_kernel(import_object(name), key, "measured")
    functions, instructions = compiling.size_of(module)
    emit_object(optimise(module, level()), level())
    print(json.dumps([name, key, functions, instructions, round(process_time() - start, 1)]), flush=True)
"""


def run(code: str, *arguments: str, stdin: str = "") -> list:
    """Run code in a new Python process; return its output, one JSON value per line."""
    done = subprocess.run([sys.executable, "-c", code, *arguments], input=stdin, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr)
    return [json.loads(line) for line in done.stdout.splitlines()]


def called(index: int) -> list[tuple[str, str]]:
    """The kernels that an example calls: (name, argument types)."""
    return [tuple(each) for each in run(JOB, str(index))[-1]]


def measured(kernels: list[tuple[str, str]]) -> dict[tuple[str, str], dict]:
    """Kernel -> functions and instructions before LLVM's optimisation, and seconds to compile.

    A kernel compiles faster if it shares functions with an earlier one.
    """
    sizes = {}
    cores = os.cpu_count() or 1
    with ThreadPoolExecutor(cores) as pool:
        shares = [json.dumps(kernels[i::cores]) for i in range(cores)]
        for rows in pool.map(lambda share: run(MEASURE, stdin=share), shares):
            for name, key, functions, instructions, seconds in rows:
                sizes[name, key] = {"functions": functions, "instructions": instructions, "seconds": seconds}
    return sizes


def device_kernels() -> list[tuple[str, str]]:
    """The kernels of devices: (name, argument types)."""
    from antumbra.techniques.culling import device_culling  # noqa: F401, it adds kernels
    from antumbra.trace.device.device_kernels import KERNELS

    return sorted({(each.kernel.name, each.key) for each in KERNELS.values()})


def written(file: Path, jobs: list[str], calls: dict, sizes: dict, devices: Sequence[tuple[str, str]] = ()) -> None:
    """Write the kernels of some jobs, and those of devices, to a file."""
    kernels = sorted({kernel for name in jobs for kernel in calls[name]})
    place = {kernel: i for i, kernel in enumerate(kernels)}
    record = {
        "kernels": [[*kernel, sizes[kernel]] for kernel in kernels],
        "jobs": {name: [place[kernel] for kernel in calls[name]] for name in jobs},
        "devices": [list(each) for each in devices],
    }
    file.write_text(json.dumps(record, indent=0) + "\n")
    print(f"{len(kernels)} kernels of {len(jobs)} jobs in {file}")


def recorded_jobs(only: str) -> tuple[dict, dict]:
    """The records of the jobs without `only` in their names: (calls, sizes)."""
    calls, sizes = {}, {}
    for file in (MANIFEST, PAPERS):
        record = json.loads(file.read_text())
        kernels = [(name, key) for name, key, _ in record["kernels"]]
        sizes |= {(name, key): size for name, key, size in record["kernels"]}
        calls |= {job: [kernels[i] for i in places] for job, places in record["jobs"].items() if only not in job}
    return calls, sizes


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--only", metavar="TEXT", default="")
    options = parser.parse_args()
    known = {(each.kernel, each.key) for each in recorded_kernels().kernels}
    product, names = ([example.name for example in all_examples(papers=papers)] for papers in (False, True))
    known |= {(each.kernel, each.key) for each in recorded_kernels().kernels}  # now with the papers' kernels
    calls, sizes = recorded_jobs(options.only) if options.only else ({}, {})
    missing = [i for i, name in enumerate(names) if name not in calls]
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        calls |= dict(zip([names[i] for i in missing], pool.map(called, missing)))
    kernels = sorted({kernel for each in calls.values() for kernel in each})
    if options.check:
        devices = {(each.kernel, each.key) for each in recorded_kernels().devices}
        new = [kernel for kernel in kernels if kernel not in known]
        new += [kernel for kernel in device_kernels() if kernel not in devices]
        print("\n".join(f"not recorded: {name} {key}" for name, key in new) or "all called kernels are recorded")
        return bool(new)
    sizes |= measured([kernel for kernel in kernels if kernel not in sizes])
    written(MANIFEST, product, calls, sizes, device_kernels())
    written(PAPERS, [name for name in names if name not in product], calls, sizes)
    return 0


if __name__ == "__main__":
    sys.exit(main())
