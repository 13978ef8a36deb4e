"""PTX written by hand: kernels that apply a few instructions to words of memory."""

import numpy as np

from antumbra.kernels.toolchain.device_code import DeviceCode

_KERNEL = """
.version 6.3
.target sm_75
.address_size 64

.visible .entry snippet(
	.param .u64 snippet_param_0,
	.param .u64 snippet_param_1
)
{
	.shared .align 16 .b8 block[512];
	.reg .pred 	%p<4>;
	.reg .b32 	%r<10>;
	.reg .b64 	%rd<10>;
	ld.param.b64 	%rd1, [snippet_param_0];
	ld.param.b64 	%rd2, [snippet_param_1];
	mov.u32 	%r9, %tid.x;
	mul.wide.u32 	%rd3, %r9, 8;
	add.s64 	%rd1, %rd1, %rd3;
	add.s64 	%rd2, %rd2, %rd3;
$INSTRUCTIONS
	ret;
}
"""


def snippet(instructions):
    """Code of a kernel: each thread's 8-byte word in is at %rd1, its word out at %rd2; %r0..8, %p0..3 are free."""
    lines = "\n".join(f"\t{line.strip()}" for line in instructions.strip().splitlines())
    text = _KERNEL.replace("$INSTRUCTIONS", lines)
    return DeviceCode("ptx", "snippet", 2, text.encode(), "0" * 32)


def run_snippet(device, instructions, words):
    """The words out of a kernel for the words in, an int64 array; one thread each, in one block."""
    words = np.ascontiguousarray(words, np.int64)
    out = np.full_like(words, -1)
    module = device.load(snippet(instructions))
    device.launch(module, np.array([words.ctypes.data, out.ctypes.data]), len(words), len(words))
    return out


def applied(device, operation, kind, result, values, constants=()):
    """The results of one instruction of up to three operands, for each tuple of values.

    operation : such as "add.rn.f32"
    kind, result : NumPy dtypes of the operands and of the result
    constants : further operands
    """
    width, out = (8 * np.dtype(each).itemsize for each in (kind, result))
    register, target = ("%r" if each == 32 else "%rd" for each in (width, out))
    values = np.atleast_2d(np.asarray(values, kind))
    n = values.shape[1]
    names = [f"{register}{5 + k}" for k in range(n)]
    loads = [f"ld.global.b{width} {name}, [%rd4+{k * width // 8}];" for k, name in enumerate(names)]
    instructions = [
        f"mul.wide.u32 %rd4, %r9, {n * width // 8};",
        "ld.global.b64 %rd5, [%rd1];",
        "sub.s64 %rd4, %rd4, %rd3;",
        "add.s64 %rd4, %rd4, %rd1;",
        *loads,
        f"{operation} {target}8, {', '.join([*names, *constants])};",
        f"st.global.b{out} [%rd2], {target}8;",
    ]
    words = np.zeros(max(len(values), -(-values.nbytes // 8)), np.int64)
    words.view(kind)[: values.size] = values.ravel()
    got = run_snippet(device, "\n".join(instructions), words)
    return got.view(result).reshape(len(words), -1)[: len(values), 0]
