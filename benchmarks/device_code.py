"""Machine code of the kernels of devices for NVIDIA's cards: registers, stack and spills, by ptxas. It needs no card.

python benchmarks/device_code.py [--arch sm_75 ...] [--json FILE]

ptxas is part of the CUDA toolkit and of the package nvidia-cuda-nvcc. A card runs as many threads at a time as its
registers allow: 65,536 in a multiprocessor of up to 2,048 threads.
"""

import argparse
import json
import re
import shutil
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

from antumbra.kernels.toolchain.device_code import DeviceKernel
from antumbra.techniques.culling import device_culling  # noqa: F401, it adds kernels
from antumbra.trace.device.device_kernels import KERNELS
from common import machine

ARCHITECTURES = ["sm_75", "sm_80", "sm_90", "sm_120"]
_REPORT = {
    "registers": re.compile(r"Used (\d+) registers"),
    "stack_bytes": re.compile(r"(\d+) bytes stack frame"),
    "spill_bytes": re.compile(r"(\d+) bytes spill stores"),
}


def ptxas() -> Path | None:
    """The program, on the path or in a package of NVIDIA's."""
    if found := shutil.which("ptxas"):
        return Path(found)
    package = find_spec("nvidia")
    folders = [] if package is None else map(Path, package.submodule_search_locations or [])
    return next((path for folder in folders for path in sorted(folder.glob("*/bin/ptxas"))), None)


def row(program: Path, name: str, kernel: DeviceKernel, architecture: str) -> dict:
    """What ptxas says of a kernel for an architecture."""
    ptx, spirv = kernel.code("ptx").code, kernel.code("spirv").code
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "kernel.ptx"
        file.write_bytes(ptx)
        command = [program, f"-arch={architecture}", "-v", file, "-o", file.with_suffix(".cubin")]
        done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(f"{name}: {done.stderr}")
    found = {key: int(pattern.search(done.stderr)[1]) for key, pattern in _REPORT.items()}
    return {"kernel": name, "architecture": architecture, **found, "ptx_bytes": len(ptx), "spirv_bytes": len(spirv)}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arch", action="append", help=f"may be repeated; default: {', '.join(ARCHITECTURES)}")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    program = ptxas()
    if program is None:
        parser.error("ptxas is not installed: pip install nvidia-cuda-nvcc")
    version = subprocess.run([program, "--version"], capture_output=True, text=True).stdout
    about = machine(1) | {"versions": f"ptxas {re.search(r'release ([0-9.]+)', version)[1]}"}
    rows = []
    print(f"{'kernel':16} {'for':7} {'registers':>9} {'stack':>6} {'spilled':>7} {'PTX':>8} {'SPIR-V':>8}")
    for name, kernel in KERNELS.items():
        for architecture in options.arch or ARCHITECTURES:
            rows.append(row(program, name, kernel, architecture))
            print("{:16} {:7} {:9} {:6} {:7} {:8} {:8}".format(*rows[-1].values()))
    if options.json:
        options.json.write_text(json.dumps({"machine": about, "rows": rows}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
