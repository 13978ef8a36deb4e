"""Every float operation of device code rounds to nearest, and damage to it is noticed."""

import re
import struct

import pytest

import device_kernels as sample
from antumbra.kernels.toolchain.device_code import FORMS
from antumbra.kernels.toolchain.rounding_checks import InexactCode, check_rounding

KERNELS = pytest.mark.parametrize("kernel", sample.SAMPLES, ids=lambda each: each.name)
CODES = {(each.name, form): each.code(form) for each in sample.SAMPLES for form in FORMS}
FLOATS, DOUBLES, LINKS = ("float_operations", "double_operations", "sorted_links")


@KERNELS
@pytest.mark.parametrize("form", FORMS)
def test_device_code_rounds_to_nearest(kernel, form):
    check_rounding(kernel.code(form))


def test_the_samples_have_float_operations_of_all_kinds():
    """So that the checks above are of something."""
    text = "".join(code.code.decode() for (_, form), code in CODES.items() if form == "ptx")
    found = set(re.findall(r"\t([a-z]+\.[rnf.\d]+) ", text))
    assert found >= {f"{name}.rn.{kind}" for name in ("add", "sub", "mul", "div", "fma") for kind in ("f32", "f64")}
    assert found >= {"sqrt.rn.f64", "min.f32", "max.f32"}


@pytest.mark.parametrize(
    "name, old, new",
    [
        (FLOATS, "add.rn.f32", "add.f32"),  # may be contracted
        (FLOATS, "add.rn.f32", "add.rz.f32"),
        (FLOATS, "add.rn.f32", "add.rn.ftz.f32"),
        (FLOATS, "mul.rn.f32", "mul.rn.sat.f32"),
        (FLOATS, "mul.rn.f32", "mul.f32"),
        (FLOATS, "fma.rn.f32", "fma.rp.f32"),
        (FLOATS, "fma.rn.f32", "mad.f32"),
        (FLOATS, "div.rn.f32", "div.approx.f32"),
        (FLOATS, "div.rn.f32", "div.full.f32"),
        (FLOATS, "sub.rn.f32", "sub.rn.f16"),
        (DOUBLES, "add.rn.f64", "add.rm.f64"),
        (DOUBLES, "sqrt.rn.f64", "rsqrt.approx.f64"),
        (DOUBLES, "fma.rn.f64", "fma.f64"),
        (LINKS, "max.f32", "max.ftz.f32"),
        (FLOATS, "ret;", "call.uni helper;"),
        (FLOATS, "ret;", "{ // callseq 0, 0\n\tcall.uni (retval0), __nv_sinf, (param0);\n\t}\n\tret;"),
        (FLOATS, ".visible .entry", ".extern .func (.param .b32 r) sinf (.param .b32 x);\n.visible .entry"),
        (FLOATS, "ret;", "ex2.approx.ftz.f32 %r1, %r1;\n\tret;"),
        (FLOATS, ".visible .entry ", ".visible .entry another_"),
    ],
)
def test_damaged_ptx_is_noticed(name, old, new):
    code = CODES[name, "ptx"]
    text = code.code.decode()
    assert old in text
    with pytest.raises(InexactCode):
        check_rounding(code._replace(code=text.replace(old, new, 1).encode()))


def instructions(code):
    """The words of each instruction of SPIR-V, after those of the header."""
    words = struct.unpack(f"<{len(code.code) // 4}I", code.code)
    parts, at = [list(words[:5])], 5
    while at < len(words):
        size = words[at] >> 16
        parts.append(list(words[at : at + size]))
        at += size
    return parts


def rebuilt(code, parts):
    words = [word for part in parts for word in part]
    return code._replace(code=struct.pack(f"<{len(words)}I", *words))


def made(opcode, *operands):
    return [(len(operands) + 1) << 16 | opcode, *operands]


def words_of(text):
    raw = text.encode() + b"\0" * (4 - len(text) % 4)
    return struct.unpack(f"<{len(raw) // 4}I", raw)


def replaced(code, opcode, change):
    """The code with the first instruction of an opcode changed: a list of words to lists of words."""
    parts = instructions(code)
    place = next(k for k, part in enumerate(parts[1:], 1) if part[0] & 0xFFFF == opcode)
    parts[place : place + 1] = change(parts[place])
    return rebuilt(code, parts)


ENTRY_MODE, EXTENDED, IMPORT, DECORATE, FADD, FMUL, TYPE_FLOAT, RETURN = 16, 12, 11, 71, 129, 133, 22, 253
DAMAGE = {
    "contraction is allowed": (FLOATS, ENTRY_MODE, lambda part: []),
    "subnormal numbers are flushed": (FLOATS, ENTRY_MODE, lambda part: [part, made(16, part[1], 4460, 32)]),
    "results are rounded to zero": (FLOATS, ENTRY_MODE, lambda part: [part, made(16, part[1], 4463, 32)]),
    "mad in the place of fma": (FLOATS, EXTENDED, lambda part: [[*part[:4], 42, *part[5:]]]),
    "a sine": (DOUBLES, EXTENDED, lambda part: [[*part[:4], 57, *part[5:]]]),
    "a native root": (DOUBLES, EXTENDED, lambda part: [[*part[:4], 92, *part[5:]]]),
    "another library": (FLOATS, IMPORT, lambda part: [made(IMPORT, part[1], *words_of("GLSL.std.450"))]),
    "fast mathematics": (FLOATS, DECORATE, lambda part: [part, made(DECORATE, part[1], 40, 16)]),
    "a conversion that rounds to zero": (FLOATS, DECORATE, lambda part: [part, made(DECORATE, part[1], 39, 1)]),
    "an imported function": (FLOATS, DECORATE, lambda part: [part, made(DECORATE, 9999, 41, *words_of("sin"), 1)]),
    "relaxed precision": (FLOATS, DECORATE, lambda part: [part, made(DECORATE, part[1], 0)]),
    "a remainder": (FLOATS, FADD, lambda part: [[part[0] & 0xFFFF0000 | 141, *part[1:]]]),
    "a call": (FLOATS, RETURN, lambda part: [made(57, 1, 2, 3), part]),
    "half precision": (FLOATS, TYPE_FLOAT, lambda part: [made(22, part[1], 16)]),
    "no entry": (FLOATS, 15, lambda part: []),
    "an entry of another name": (FLOATS, 15, lambda part: [[*part[:3], part[3] + 1, *part[4:]]]),
    "an extension for products": (FLOATS, IMPORT, lambda part: [made(10, *words_of("SPV_KHR_float_controls2")), part]),
    "a number that is defined twice": (FLOATS, 248, lambda part: [made(248, 1)]),
    "a second function": (FLOATS, RETURN, lambda part: [part, made(54, 1, 2, 3, 4)]),
}


@pytest.mark.parametrize("name, opcode, change", DAMAGE.values(), ids=DAMAGE)
def test_damaged_spirv_is_noticed(name, opcode, change):
    with pytest.raises(InexactCode):
        check_rounding(replaced(CODES[name, "spirv"], opcode, change))


def test_truncated_spirv_is_noticed():
    code = CODES[FLOATS, "spirv"]
    for size in (0, 3, 12, len(code.code) - 4, len(code.code) - 1):
        with pytest.raises(InexactCode):
            check_rounding(code._replace(code=code.code[:size]))


def test_unchanged_spirv_survives_taking_it_apart():
    code = CODES[FLOATS, "spirv"]
    assert rebuilt(code, instructions(code)) == code
    check_rounding(replaced(code, FMUL, lambda part: [part]))


def test_an_entry_in_ptx_is_the_only_one():
    code = CODES[FLOATS, "ptx"]
    second = re.sub(rb".*(?=\.visible)", b"", code.code, flags=re.S).replace(code.entry.encode(), b"other")
    with pytest.raises(InexactCode, match="entries"):
        check_rounding(code._replace(code=code.code + second))
