"""Emission of device code by LLVM, in a process of its own.

LLVM's SPIR-V back end keeps the numbers of labels from one module to the next, so only the first module of a process
comes out right. And where a target lacks an operation, LLVM ends the process; here, that is an error.
"""

import json
import subprocess
import sys
from base64 import b64decode
from collections.abc import Sequence
from typing import NamedTuple

_PROGRAM = """
import base64, json, sys
path, modules = json.load(sys.stdin)
sys.path[:] = path
import llvmlite.binding as llvm
llvm.initialize_all_targets()
llvm.initialize_all_asmprinters()
codes = []
for triple, cpu, features, assembly in modules:
    machine = llvm.Target.from_triple(triple).create_target_machine(cpu=cpu, features=features, opt=3)
    module = llvm.parse_assembly(assembly)
    module.triple, module.data_layout = triple, str(machine.target_data)
    module.verify()
    code = machine.emit_assembly(module).encode() if triple.startswith("nvptx") else machine.emit_object(module)
    codes.append(base64.b64encode(code).decode())
print(json.dumps(codes))
"""


class TargetModule(NamedTuple):
    """A module of a target, ready for emission."""

    triple: str
    cpu: str
    features: str
    assembly: str  # LLVM's, without lines that name a target


class EmissionError(TypeError):
    """LLVM cannot emit a module for a target."""


def emit_modules(modules: Sequence[TargetModule]) -> list[bytes]:
    """The code of modules, at most one of which is for SPIR-V: text of PTX, or SPIR-V.

    Raises
    ------
    EmissionError
        If LLVM cannot emit one of them; the message is LLVM's.
    """
    request = json.dumps([sys.path, modules])
    done = subprocess.run([sys.executable, "-c", _PROGRAM], input=request, capture_output=True, text=True)
    if done.returncode:
        lines = done.stderr.splitlines() or ["LLVM has ended the process"]
        raise EmissionError(next((line for line in lines if "LLVM ERROR" in line or "Assertion" in line), lines[-1]))
    return [b64decode(code) for code in json.loads(done.stdout)]
