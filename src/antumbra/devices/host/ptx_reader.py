"""The text of PTX, as LLVM writes it, read into instructions. What the reader does not know is an error."""

import re
from typing import NamedTuple

from ..device import DeviceError


class Instruction(NamedTuple):
    """One instruction, or a label before one."""

    line: str  # as it stands in the text
    operation: tuple[str, ...]  # such as ("ld", "global", "v2", "b32"); a label has none
    operands: tuple[str, ...]  # such as ("{%r1, %r2}", "[%rd1+8]"); of a label, its name
    predicate: str | None = None  # register
    negated: bool = False  # whether it is executed if the predicate is false

    @property
    def kind(self) -> str:
        """The type that the operation works on, such as "f32"."""
        return self.operation[-1]


class PtxKernel(NamedTuple):
    """A kernel of a PTX module."""

    entry: str
    parameters: list[str]  # names; each is 64 bits wide
    registers: dict[str, int]  # name -> bits; predicates have one
    own_memory: dict[str, int]  # name of an array in a thread's memory -> bytes
    block_memory: dict[str, int]  # name of an array in a block's memory -> bytes
    instructions: list[Instruction]


_KERNEL = re.compile(r"\.visible \.entry (\w+)\((.*?)\)\s*((?:\.\w+ [\d, ]+\s*)*)\{(.*)\}\s*", re.S)
_HEAD = re.compile(r"\s*(?:\.(?:version|target|address_size) \S+\s+)*")
_PARAMETER = re.compile(r"\s*\.param \.u64 (\w+)\s*")
_MEMORY = re.compile(r"\.(local|shared) \.align \d+ \.b8\s+(\w+)\[(\d+)\];")
_HINT = '.pragma "nounroll";'  # to the driver's compiler, about a loop
_REGISTERS = re.compile(r"\.reg \.(\w+)\s+%(\w+)(?:<(\d+)>)?;")
_LABEL = re.compile(r"(\$?\w+):")
_INSTRUCTION = re.compile(r"(?:@(!?)(%\w+)\s+)?([a-z][\w.]*)\s*([^;]*);")
_OPERAND = re.compile(r"\{[^}]*\}|\[[^\]]*\]|[^,\s]+")


def bits_of(kind: str) -> int:
    """The width of a type such as "u32"."""
    return 1 if kind == "pred" else int(kind[1:])


def read_kernel(text: str) -> PtxKernel:
    """The kernel of a module that has one kernel, and no functions and variables.

    Raises
    ------
    DeviceError
        If the text has something that the reader does not know.
    """
    text = re.sub(r"//.*", "", text)
    whole = re.fullmatch(_HEAD.pattern + _KERNEL.pattern, text, re.S)
    if whole is None:
        raise DeviceError("the host device runs modules of one kernel without functions and variables")
    entry, parameters, _, body = whole.groups()
    kernel = PtxKernel(entry, [], {}, {}, {}, [])
    for each in filter(str.strip, parameters.split(",")):
        kernel.parameters.append(_matched(_PARAMETER, each)[1])
    for line in filter(None, map(str.strip, body.splitlines())):
        _read_line(line, kernel)
    return kernel


def _matched(pattern: re.Pattern[str], text: str) -> re.Match[str]:
    match = pattern.fullmatch(text)
    if match is None:
        raise DeviceError(f"the host device cannot read PTX: {text.strip()}")
    return match


def _read_line(line: str, kernel: PtxKernel) -> None:
    """Add a line of a kernel's body to it."""
    if memory := _MEMORY.fullmatch(line):
        where = kernel.own_memory if memory[1] == "local" else kernel.block_memory
        where[memory[2]] = int(memory[3])
    elif registers := _REGISTERS.fullmatch(line):
        kind, name, count = registers.groups()
        names = [name] if count is None else [f"{name}{k}" for k in range(int(count))]
        kernel.registers.update({f"%{each}": bits_of(kind) for each in names})
    elif line == _HINT:
        return
    elif label := _LABEL.fullmatch(line):
        kernel.instructions.append(Instruction(line, (), (label[1],)))
    else:
        negated, predicate, operation, operands = _matched(_INSTRUCTION, line).groups()
        parts = tuple(operation.split(".")), tuple(_OPERAND.findall(operands))
        kernel.instructions.append(Instruction(line, *parts, predicate, bool(negated)))
