"""The LLVM module of a device kernel, optimised and the same for all targets.

Numba lowers the kernel as for a processor. It is wrapped in a function of the argument words, inlined into it as a
whole, and optimised for a machine without vectors, where `fma` is an instruction. The functions of
`antumbra.kernels.device` stay opaque: each target defines them.
"""

import re
from functools import cache

import llvmlite.binding as llvm

from ..device.operations import PREFIX
from ..jit import kernel
from ..machine_code import is_level_operation, source_of
from ..marshalling import NONE, struct_of
from .address_spaces import with_address_spaces
from .compiling import lower_kernel

TRIPLE = "nvptx64-nvidia-cuda"
PROCESSOR, FEATURES = "sm_75", "+ptx63"
"""Turing: the oldest cards that recent drivers accept. PTX 6.3 is the first version for them."""

_FUSING_LEVEL = "x86-64-v3"  # `machine_code.source_of`: the rounding error of a product by fma
_RAISED = f"{PREFIX}raised"
_MEETINGS = tuple(f"{PREFIX}{name}" for name in ("shuffle", "ballot", "barrier"))
_MATHEMATICS = """
declare double @llvm.sqrt.f64(double)
declare float @llvm.sqrt.f32(float)

define linkonce_odr double @sqrt(double %x) alwaysinline {
  %root = call double @llvm.sqrt.f64(double %x)
  ret double %root
}

define linkonce_odr float @sqrtf(float %x) alwaysinline {
  %root = call float @llvm.sqrt.f32(float %x)
  ret float %root
}
"""
"""Functions of the C library that are single operations of a device."""


EXACT_OF_FLOATS = (
    *("fma", "fmuladd", "sqrt", "fabs", "copysign", "floor", "ceil", "trunc", "rint", "nearbyint", "roundeven"),
    *("minnum", "maxnum", "minimum", "maximum", "fptosi.sat", "fptoui.sat"),
)
EXACT_OF_INTEGERS = (
    *("abs", "smin", "smax", "umin", "umax", "ctpop", "ctlz", "cttz", "sadd.sat", "ssub.sat", "uadd.sat", "usub.sat"),
    *("smul.with.overflow", "umul.with.overflow", "uadd.with.overflow", "usub.with.overflow"),
)
"""LLVM's intrinsics of which both targets make exact operations. For some others, LLVM ends the process."""

_OF_MEMORY = (
    "memcpy",
    "memmove",
    "memset",
    "assume",
    "lifetime.start",
    "lifetime.end",
    "prefetch",
    "experimental.noalias",
)
_KNOWN = re.compile(
    rf"llvm\.(?:{'|'.join(map(re.escape, (*EXACT_OF_FLOATS, *EXACT_OF_INTEGERS, *_OF_MEMORY)))})(?:\.|$)"
)
_REFUSED = {
    r"\bbitcast <\d+ x i1>": "the bits of a mask",
    r"(?<![%@.\w])i(?!(?:1|8|16|32|64)\b)\d+\b": "integers of odd widths",
    r"\b(?:half|bfloat|fp128|x86_fp80)\b": "floats of other widths",
    r"\bx ptr[\]>]|\{[^}\n]*\bptr\b": "vectors or structures of pointers",
    r"\bfrem\b": "remainders of floats",
    r"\batomicrmw f": "atomic operations on floats",
    r"^@": "tables of constants",
}
"""What a target cannot do: pattern in LLVM assembly -> its name."""


@cache
def target_machine() -> llvm.TargetMachine:
    """The machine that modules are optimised for."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    return llvm.Target.from_triple(TRIPLE).create_target_machine(cpu=PROCESSOR, features=FEATURES, opt=3)


def parsed(assembly: str) -> llvm.ModuleRef:
    """A module, from assembly without a target."""
    machine = target_machine()
    module = llvm.parse_assembly(f'target datalayout = "{machine.target_data}"\ntarget triple = "{TRIPLE}"\n{assembly}')
    module.verify()
    return module


def without_target(assembly: str) -> str:
    """Assembly without the lines that name a target."""
    return re.sub(r"^target (?:triple|datalayout).*$", "", assembly, flags=re.M)


def inline_everything(module: llvm.ModuleRef, entry: str) -> None:
    """Make all functions but the entry part of it, and drop them."""
    for function in module.functions:
        if not function.is_declaration and function.name != entry:
            function.linkage = "internal"
            function.add_function_attribute("alwaysinline")
    builder = llvm.create_pass_builder(target_machine(), llvm.create_pipeline_tuning_options())
    passes = llvm.create_new_module_pass_manager()
    passes.add_always_inliner_pass()
    passes.add_global_dead_code_eliminate_pass()
    passes.run(module, builder)


def _wrapper(body: str, entry: str, words: int) -> str:
    """The function of a kernel's argument words, which calls its body."""
    parameters = ", ".join(f"i64 %w{k}" for k in range(words))
    stores = "\n".join(
        f"  %p{k} = getelementptr i64, ptr %words, i64 {k}\n  store i64 %w{k}, ptr %p{k}" for k in range(words)
    )
    return f"""
declare i64 @{body}(ptr, ptr)
declare void @{_RAISED}()

define void @{entry}({parameters}) "no-jump-tables"="true" {{
  %words = alloca [{max(words, 1)} x i64]
  %result = alloca i64
{stores}
  %status = call i64 @{body}(ptr %words, ptr %result)
  %raised = icmp ne i64 %status, 0
  br i1 %raised, label %failed, label %done
failed:
  call void @{_RAISED}()
  br label %done
done:
  ret void
}}
"""


def device_ir(function: kernel, key: str, entry: str) -> str:
    """LLVM assembly of a device kernel: one function of argument words named `entry`, and declarations.

    Raises
    ------
    TypeError
        If the kernel returns something, may raise, calls a function that no device has, or uses pointers whose memory
        is not known.
    numba.core.errors.NumbaError
        If Numba cannot compile the kernel.
    """
    body = f"{entry}_body"
    lowered, result = lower_kernel(function, key, body)
    if result != NONE:
        raise TypeError(f"{function.name} returns a value: a device kernel writes its results to memory")
    module = parsed(without_target(str(lowered)))
    if any(each.is_declaration and is_level_operation(each.name) for each in module.functions):
        module.link_in(parsed(source_of(_FUSING_LEVEL)))
    words = struct_of(tuple(key.split())).size // 8
    for source in _MATHEMATICS, _wrapper(body, entry, words):
        module.link_in(parsed(source))
    if any(each.name in _MEETINGS for each in module.functions):
        for each in module.functions:
            each.add_function_attribute("convergent")
    inline_everything(module, entry)
    _optimise(module)
    declared = [each.name for each in module.functions if each.is_declaration]
    foreign = [name for name in declared if not name.startswith(PREFIX) and not _KNOWN.match(name)]
    if foreign:
        raise TypeError(f"{function.name} needs {', '.join(foreign)}: a device has no such function")
    if _RAISED in declared:
        raise TypeError(f"{function.name} may raise: a device kernel cannot")
    assembly = without_target(str(module)).replace("@llvm.fmuladd.", "@llvm.fma.")
    for pattern, what in _REFUSED.items():
        if re.search(pattern, assembly, re.M):
            raise TypeError(f"{function.name} needs {what}: device kernels have none")
    try:
        return with_address_spaces(assembly)
    except TypeError as error:
        raise TypeError(f"{function.name}: {error}") from None


def _optimise(module: llvm.ModuleRef) -> None:
    """Run LLVM's passes as `machine_code.optimise` does, without vectorisation."""
    for cheap in True, False:
        options = llvm.create_pipeline_tuning_options()
        options.speed_level = 0 if cheap else 3
        options.loop_vectorization = options.slp_vectorization = False
        builder = llvm.create_pass_builder(target_machine(), options)
        passes = builder.getModulePassManager()
        if cheap:
            passes.add_loop_rotate_pass()
            passes.add_instruction_combine_pass()
            passes.add_jump_threading_pass()
        else:
            passes.add_global_dead_code_eliminate_pass()
            passes.add_strip_dead_prototype_pass()
            passes.add_strip_symbols_pass()  # Numba numbers its names in the order of compilation
        passes.run(module, builder)
