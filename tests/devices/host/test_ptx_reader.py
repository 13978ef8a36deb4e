"""The text of PTX is read into registers, memory and instructions; a line that is not known is an error."""

import pytest

from antumbra.devices.device import DeviceError
from antumbra.devices.host.ptx_reader import Instruction, read_kernel
from ptx_snippets import snippet


def read(instructions):
    return read_kernel(snippet(instructions).code.decode())


def test_a_kernel_has_parameters_registers_and_memory():
    kernel = read(".local .align 64 .b8 \t__local_depot0[320];\n.reg .b64 %SP;")
    assert kernel.entry == "snippet" and kernel.parameters == ["snippet_param_0", "snippet_param_1"]
    assert kernel.own_memory == {"__local_depot0": 320} and kernel.block_memory == {"block": 512}
    widths = {name: kernel.registers[name] for name in ("%p3", "%r9", "%rd0", "%SP")}
    assert widths == {"%p3": 1, "%r9": 32, "%rd0": 64, "%SP": 64} and "%r10" not in kernel.registers


@pytest.mark.parametrize(
    "line, expected",
    [
        ("ret;", (("ret",), ())),
        ("$L__BB0_2:", ((), ("$L__BB0_2",))),
        (
            "st.global.v2.b32 [%rd1+-8], {%r1, %r2}; // a comment",
            (("st", "global", "v2", "b32"), ("[%rd1+-8]", "{%r1, %r2}")),
        ),
        ("@%p1 bra $L__BB0_2;", (("bra",), ("$L__BB0_2",), "%p1")),
        ("@!%p1 add.rn.f32 %r1, %r2, 0f3F800000;", (("add", "rn", "f32"), ("%r1", "%r2", "0f3F800000"), "%p1", True)),
    ],
)
def test_an_instruction_has_an_operation_operands_and_a_predicate(line, expected):
    text = line.partition("//")[0].strip()
    assert read(line).instructions[-2] == Instruction(text, *expected)


@pytest.mark.parametrize("line", ["call foo(); ret;", ".pragma nounroll;", ".reg .b32 %x, %y;", "{"])
def test_a_line_that_cannot_be_read_is_an_error(line):
    with pytest.raises(DeviceError):
        read(line)


@pytest.mark.parametrize(
    "line", [".global .align 4 .b8 table[4];", ".func helper() { ret; }", ".extern .func vprintf;"]
)
def test_a_module_with_anything_but_a_kernel_is_an_error(line):
    code = snippet("")
    with pytest.raises(DeviceError, match="modules of one kernel"):
        read_kernel(code.code.decode().replace(".visible", f"{line}\n.visible", 1))
