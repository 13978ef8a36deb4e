"""Proof from device code itself that its results are the ones of the processor, bit for bit.

Every float operation must round to nearest; none may flush subnormal numbers, be contracted with another, or be
approximate; and the code must be complete. The checks list what is exact: an instruction that they do not know is an
error, whatever it does.

What is left to a driver: OpenCL lets it round float32 division and roots coarsely, unless a program is built with
``-cl-fp32-correctly-rounded-divide-sqrt``.
"""

import re
import struct
from collections.abc import Iterator
from typing import NamedTuple

from .device_code import DeviceCode


class InexactCode(ValueError):
    """Device code whose results may differ from those of the processor; the message has the instruction."""


def check_rounding(code: DeviceCode) -> None:
    """Raise `InexactCode` unless all float operations of a kernel round to nearest, and nothing is external."""
    (_check_ptx if code.form == "ptx" else _check_spirv)(code)


# --- PTX --------------------------------------------------------------------------------------------------------------


_FLOAT = r"f(?:32|64)"
_EXACT_FLOATS = re.compile(
    "|".join(
        [
            rf"(?:add|sub|mul|div|fma|rcp|sqrt)\.rn\.{_FLOAT}",  # .rn also keeps the driver from contracting
            rf"(?:min|max|neg|abs|copysign|mov|selp)\.{_FLOAT}",
            rf"(?:ld|st)\.(?:param|global|local|shared)(?:\.v[24])?\.{_FLOAT}",
            rf"setp\.(?:eq|ne|lt|le|gt|ge|equ|neu|ltu|leu|gtu|geu|num|nan)\.{_FLOAT}",
            r"cvt\.f64\.f32",
            r"cvt\.rn\.f32\.f64",
            rf"cvt\.rn\.{_FLOAT}\.[su](?:8|16|32|64)",
            rf"cvt\.r[nzmp]i\.[su](?:8|16|32|64)\.{_FLOAT}",
            r"cvt\.r[nzmp]i\.(?:f32\.f32|f64\.f64)",
        ]
    )
)
_INTEGER_TYPE = r"(?:[sub](?:8|16|32|64)|pred)"
_OTHERS = re.compile(
    "|".join(
        [
            r"bra(?:\.uni)?|ret|exit",
            rf"(?:mov|add|sub|neg|not|and|or|xor|min|max|abs|div|rem|shl|shr|popc|clz|brev|selp|cvta\.\w+)\.{_INTEGER_TYPE}",
            rf"(?:mul|mad)\.(?:lo|hi|wide)\.{_INTEGER_TYPE}",
            rf"setp\.(?:eq|ne|lt|le|gt|ge|lo|ls|hi|hs)\.{_INTEGER_TYPE}",
            rf"cvt\.{_INTEGER_TYPE}\.{_INTEGER_TYPE}",
            r"shf\.[lr]\.wrap\.b32|bfe\.[us](?:32|64)",
            rf"(?:ld|st)\.(?:param|global|local|shared)(?:\.v[24])?\.{_INTEGER_TYPE}",
            r"(?:atom|red)\.(?:global|shared)\.(?:add|min|max|and|or|xor|exch|cas)\.[sub](?:32|64)",
            r"shfl\.sync\.idx\.b32|vote\.sync\.ballot\.b32|bar\.sync|barrier\.sync\.aligned",
        ]
    )
)
_PTX_DIRECTIVES = re.compile(
    r"\.version \d+\.\d+|\.target sm_\d+|\.address_size 64|\.visible \.entry \w+\(|\.param \.u64 \w+,?|\)|[{}]"
    r"|\.reg \.\w+\s+%\w+(?:<\d+>)?;|\.(?:local|shared) \.align \d+ \.b8\s+\w+\[\d+\];|\$\w+:"
    r"|\.pragma \"nounroll\";"
)
_PTX_INSTRUCTION = re.compile(r"(?:@!?%\w+\s+)?([\w.]+)\b.*;")


def _check_ptx(code: DeviceCode) -> None:
    text = re.sub(r"//.*", "", code.code.decode())
    entries = re.findall(r"\.entry (\w+)", text)
    if entries != [code.entry]:
        raise InexactCode(f"PTX of {code.entry} has the entries {', '.join(entries) or 'none'}")
    for line in filter(None, map(str.strip, text.splitlines())):
        if _PTX_DIRECTIVES.fullmatch(line):
            continue
        instruction = _PTX_INSTRUCTION.fullmatch(line)
        if not (instruction and (_EXACT_FLOATS.fullmatch(instruction[1]) or _OTHERS.fullmatch(instruction[1]))):
            raise InexactCode(f"PTX of {code.entry}: not known to be exact: {line}")


# --- SPIR-V -----------------------------------------------------------------------------------------------------------


_MAGIC, _HEADER_WORDS = 0x07230203, 5
_VERSIONS = range(0x10000, 0x10301)

# opcodes that are checked further
_NAME, _EXTENSION, _IMPORT, _INSTRUCTION, _ENTRY_POINT, _EXECUTION_MODE = 5, 10, 11, 12, 15, 16
_CAPABILITY, _TYPE_FLOAT, _FUNCTION, _FUNCTION_END, _DECORATE = 17, 22, 54, 56, 71

_EXACT_OPERATIONS = frozenset(
    [
        *(0, 1, 3, 4, 5, 6, 10, 11, 12, 14, 15, 16, 17),  # names, modes, imports, instructions of OpenCL
        *(19, 20, 21, 22, 23, 28, 30, 32, 33),  # types
        *(41, 42, 43, 44, 46),  # constants
        *(54, 55, 56, 59, 61, 62, 63, 64, 65, 66, 67, 70, 71, 72),  # functions, memory, decorations
        *(77, 78, 79, 80, 81, 82),  # parts of vectors
        *(109, 110, 111, 112, 113, 114, 115, 117, 120, 124),  # conversions
        *(126, 127, 128, 129, 130, 131, 132, 133, 134, 135, 136, 137, 138, 139),  # arithmetic without OpFRem, OpFMod
        *(149, 150, 151, 152, 154, 155, 156, 157, 162, 163, 164, 165, 166, 167, 168, 169),  # carries, logic, OpSelect
        *range(170, 192),  # comparisons
        *(194, 195, 196, 197, 198, 199, 200, 204, 205),  # bits
        *(224, 225, *range(227, 243)),  # barriers, atomics
        *(245, 246, 247, 248, 249, 250, 251, 253, 255, 256, 257),  # control
        *(339, 345),  # ballot, shuffle
    ]
)
"""Opcodes of instructions without rounding, or that round to nearest. Calls of functions are not among them."""

_EXACT_OPENCL = frozenset(
    [
        *(12, 13, 23, 25, 26, 27, 28, 53, 55, 61, 66),  # ceil copysign fabs floor fma fmax fmin rint round sqrt trunc
        *(141, 143, 144, 151, 152, 156, 157, 158, 159, 160, 161, 162, 163, 166, 201, 203),  # integers
    ]
)
"""Instructions of OpenCL that are exact. Not mad, the native and half ones, and not fmin_common, which loses NaN."""

_CONTRACTION_OFF = 31
_HARMLESS_MODES = {_CONTRACTION_OFF, 4459, 4461, 4462}  # preserve denormals, signed zeros and NaN; round to even
_KERNEL_MODEL = 6
_CAPABILITIES = {4, 5, 6, 7, 10, 11, 12, 18, 22, 38, 39, 61, 64, 65}  # pointers, integers, float64 and subgroups
_EXTENSIONS = {"SPV_KHR_no_integer_wrap_decoration"}
_ROUNDING_MODE, _LINKAGE, _BUILT_IN, _TO_EVEN = 39, 41, 11, 0
_DECORATIONS = {_BUILT_IN, _ROUNDING_MODE, _LINKAGE, 19, 22, 28, 38, 44, 45, 4469, 4470}
"""Decorations without effect on floats; saturated conversion (28) is exact. Fast mathematics (40) is not among them."""


_WITHOUT_RESULT = {0, 3, 4, 5, 6, 10, 14, 15, 16, 17, 56, 62, 63, 64, 71, 72, 224, 225, 228, *range(246, 258)} - {248}
_WITHOUT_TYPE = {11, 248, *range(19, 34)}  # imports, labels and types: the result is their first operand


class _Words(NamedTuple):
    """An instruction of SPIR-V: its opcode and operands."""

    opcode: int
    operands: tuple[int, ...]

    @property
    def result(self) -> int | None:
        """The number of what it defines; None if it defines nothing."""
        return None if self.opcode in _WITHOUT_RESULT else self.operands[self.opcode not in _WITHOUT_TYPE]

    def text(self, first: int) -> str:
        """The text in the operands from `first` on."""
        raw = struct.pack(f"<{len(self.operands) - first}I", *self.operands[first:])
        return raw.split(b"\0", 1)[0].decode()


def _decoded(code: DeviceCode) -> Iterator[_Words]:
    """The instructions of a module."""
    if len(code.code) % 4 or len(code.code) < 4 * _HEADER_WORDS:
        raise InexactCode(f"SPIR-V of {code.entry} is truncated")
    words = struct.unpack(f"<{len(code.code) // 4}I", code.code)
    if words[0] != _MAGIC or words[1] not in _VERSIONS:
        raise InexactCode(f"SPIR-V of {code.entry} is of another version")
    at = _HEADER_WORDS
    while at < len(words):
        size, opcode = words[at] >> 16, words[at] & 0xFFFF
        if size == 0 or at + size > len(words):
            raise InexactCode(f"SPIR-V of {code.entry} is truncated")
        yield _Words(opcode, words[at + 1 : at + size])
        at += size


def _check_spirv(code: DeviceCode) -> None:
    instructions = list(_decoded(code))
    if not instructions or instructions[-1].opcode != _FUNCTION_END:
        raise InexactCode(f"SPIR-V of {code.entry} is truncated")
    built_in = {each.operands[0] for each in instructions if each.opcode == _DECORATE and each.operands[1] == _BUILT_IN}
    entries = [each for each in instructions if each.opcode == _ENTRY_POINT]
    names = [each.text(2) for each in entries]
    if names != [code.entry] or entries[0].operands[0] != _KERNEL_MODEL:
        raise InexactCode(f"SPIR-V of {code.entry} has the entries {', '.join(names) or 'none'}")
    modes = {(each.operands[0], each.operands[1]) for each in instructions if each.opcode == _EXECUTION_MODE}
    if (entries[0].operands[1], _CONTRACTION_OFF) not in modes:
        raise InexactCode(f"SPIR-V of {code.entry} allows contraction")
    if sum(each.opcode == _FUNCTION for each in instructions) != 1:
        raise InexactCode(f"SPIR-V of {code.entry} has other functions")
    defined = set[int]()
    for each in instructions:
        if not _is_exact(each, built_in):
            raise InexactCode(f"SPIR-V of {code.entry}: not known to be exact: opcode {each.opcode} {each.operands}")
        if each.result in defined:  # LLVM has made such modules, and drivers crash
            raise InexactCode(f"SPIR-V of {code.entry} defines number {each.result} twice")
        if each.result is not None:
            defined.add(each.result)


def _is_exact(each: _Words, built_in: set[int]) -> bool:
    """Whether an instruction is known to be exact.

    built_in : variables that the device defines, the only ones that a module may import
    """
    opcode, operands = each
    if opcode == _INSTRUCTION:
        return operands[3] in _EXACT_OPENCL
    if opcode == _IMPORT:
        return each.text(1) == "OpenCL.std"
    if opcode == _EXTENSION:
        return each.text(0) in _EXTENSIONS
    if opcode == _EXECUTION_MODE:
        return operands[1] in _HARMLESS_MODES
    if opcode == _CAPABILITY:
        return operands[0] in _CAPABILITIES
    if opcode == _TYPE_FLOAT:
        return operands[1] in (32, 64)
    if opcode == _DECORATE:
        target, decoration, *values = operands
        if decoration == _ROUNDING_MODE:
            return values == [_TO_EVEN]
        return decoration in _DECORATIONS and (decoration != _LINKAGE or target in built_in)
    return opcode in _EXACT_OPERATIONS
