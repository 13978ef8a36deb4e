"""LLVM: optimise the IR of a kernel and emit machine code for a level of processors."""

from functools import cache

import llvmlite.binding as llvm

from .simd.by_level import is_missing, source_of

_TRIPLES = {"x86_64": ("x86-64", "x86_64-unknown-linux-gnu"), "aarch64": ("aarch64", "aarch64-unknown-linux-gnu")}
"""Architecture: (prefix of its levels' names, LLVM's target triple), for compiling on another architecture."""


@cache
def _target_machine(level: str) -> llvm.TargetMachine:
    here = llvm.get_process_triple()
    begins = {machine: name for machine, (name, _) in _TRIPLES.items()}
    foreign = [m for m, name in begins.items() if level.startswith(name) and not here.startswith((m, name))]
    if foreign:
        llvm.initialize_all_targets()
        llvm.initialize_all_asmprinters()
    else:
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
    triple = _TRIPLES[foreign[0]][1] if foreign else here
    processor = level if level.startswith("x86") else "generic"
    model = {"reloc": "static", "codemodel": "jitdefault"}
    return llvm.Target.from_triple(triple).create_target_machine(cpu=processor, opt=3, jit=not foreign, **model)


def optimised(module: llvm.ModuleRef, level: str) -> llvm.ModuleRef:
    """The module with its functions inlined and optimised.

    A cheap run of passes brings loops into shape, and a full run follows. Floating-point operations stay as written:
    none is contracted or reordered.
    """
    machine = _target_machine(level)
    if any(function.is_declaration and is_missing(function.name) for function in module.functions):
        module.link_in(llvm.parse_assembly(source_of(level)))
    module.triple, module.data_layout = machine.triple, str(machine.target_data)
    for cheap in True, False:
        options = llvm.create_pipeline_tuning_options()
        options.speed_level = 0 if cheap else 3
        options.loop_vectorization, options.slp_vectorization = not cheap, False
        builder = llvm.create_pass_builder(machine, options)
        passes = builder.getModulePassManager()
        if cheap:
            passes.add_loop_rotate_pass()
            passes.add_instruction_combine_pass()
            passes.add_jump_threading_pass()
        passes.run(module, builder)
    return module


def emitted(module: llvm.ModuleRef, level: str) -> bytes:
    """An object file of a module."""
    return _target_machine(level).emit_object(module)


def assembly(module: llvm.ModuleRef, level: str) -> str:
    """The module in the processor's assembly language."""
    return _target_machine(level).emit_assembly(module)
