"""Parts: kernels, inlined functions and overloads as Numba sees them, compiled for argument types to LLVM IR.

A part takes the place of Numba's dispatcher. It leaves out features that kernels do not need: entries for Python and C,
parallel loops, object mode, and memory managed by reference counts.
"""

from collections.abc import Callable
from typing import NamedTuple

from numba.core import compiler, compiler_machinery, types, typing
from numba.core import typed_passes as typed
from numba.core import untyped_passes as untyped
from numba.core.imputils import user_function
from numba.core.registry import cpu_target
from numba.core.typing.templates import fold_arguments
from numba.core.utils import pysignature

from .jit import guest_overloads, inlined, overloads
from .library import Library

_PASSES = (
    (untyped.TranslateByteCode, "bytecode to IR"),
    (untyped.FixupArgs, "arguments"),
    (untyped.IRProcessing, "IR"),
    (untyped.InlineClosureLikes, "closures"),
    (untyped.RewriteSemanticConstants, "constants"),
    (untyped.DeadBranchPrune, "dead branches"),
    (untyped.GenericRewrites, "rewrites"),
    (untyped.ReconstructSSA, "SSA"),
    (untyped.DeadBranchPrune, "dead branches"),
    (typed.NopythonTypeInference, "types"),
    (typed.PreLowerStripPhis, "phi nodes"),
    (typed.NopythonRewrites, "typed rewrites"),
    (typed.IRLegalization, "legal IR"),
    (typed.NativeLowering, "lowering"),
)


class _Passes(compiler_machinery.PassManager):
    """Runs passes without Numba's timing, events and checks of each pass."""

    def _runPass(self, index, each, state):
        each.analysis = self._analysis
        for run in each.run_initialization, each.run_pass, each.run_finalizer:
            run(state)


class _Pipeline(compiler.CompilerBase):
    def define_pipelines(self):
        passes = _Passes("antumbra")
        for each, what in _PASSES:
            passes.add_pass(each, what)
        passes.finalize()
        return [passes]


class Lowered(NamedTuple):
    """A part compiled for argument types."""

    signature: typing.Signature
    fndesc: object  # Numba's description of the function: name and types
    library: Library


class Part:
    """A function that other compiled functions call; Numba takes it for a dispatcher."""

    def __init__(self, py_func: Callable, choose: Callable, forced: bool):
        self.py_func, self._choose, self._forced = py_func, choose, forced
        self._signature = pysignature(py_func)
        self.lowered: dict[tuple[types.Type, ...], Lowered] = {}
        self.is_compiling = 0  # Numba reads this for functions that call themselves
        self.type = types.Dispatcher(self)

    def __repr__(self):
        return self.py_func.__qualname__

    def get_call_template(self, args, kws):
        """Called by Numba: the type that a call with arguments of these types returns."""
        signature, args = self.fold_argument_types(args, kws)
        found, name = self.lower(tuple(args)), self.py_func.__name__
        return typing.make_concrete_template(name, name, [found.signature]), signature, args, {}

    def fold_argument_types(self, args, kws):
        """Called by Numba: the types of all arguments, given by position, by name or by default."""
        keep = lambda index, parameter, value: value
        default = lambda index, parameter, value: types.Omitted(value)
        return self._signature, fold_arguments(self._signature, args, kws, keep, default, keep)

    def get_overload(self, signature):
        """Called by Numba: the key of the code, as given to `insert_user_function`."""
        return self.lowered[tuple(signature)]

    @property
    def nopython_signatures(self):
        return [found.signature for found in self.lowered.values()]

    def lower(self, args: tuple[types.Type, ...]) -> Lowered:
        """Types and LLVM IR for argument types. Call it under Numba's compiler lock, within `library.kept_as_ir`."""
        found = self.lowered.get(args)
        if found is None:
            typing_context, context = cpu_target.typing_context, cpu_target.target_context
            library = Library(context.codegen(), self.py_func.__qualname__)
            function, flags = self._choose(args), _flags(self._forced)
            self.is_compiling += 1
            try:
                made = compiler.compile_extra(
                    typing_context, context, function, args, None, flags, {}, library, pipeline_class=_Pipeline
                )
            finally:
                self.is_compiling -= 1
            found = Lowered(typing.signature(made.fndesc.restype, *args), made.fndesc, library)
            implementation = _call_of(made.fndesc, library)
            context._defns[found].append(implementation, implementation.signature)
            self.lowered[args] = found
        return found


def _call_of(fndesc, library: Library):
    """What callers of a function run: Numba's `user_function`, without the test for errors if it never raises."""
    if isinstance(fndesc.restype, types.Optional) or not library.never_fails(fndesc.llvm_func_name):
        return user_function(fndesc, [library])

    def call(context, builder, signature, args):
        function = context.declare_function(builder.module, fndesc)
        _, value = context.call_conv.call_function(builder, function, fndesc.restype, fndesc.argtypes, args)
        return value

    call.signature, call.libs = fndesc.argtypes, (library,)  # type: ignore[attr-defined]
    return call


def _flags(forced: bool) -> compiler.Flags:
    flags = compiler.Flags()
    flags.nrt = False
    flags.no_compile = True
    flags.no_cpython_wrapper = True
    flags.no_cfunc_wrapper = True
    flags.release_gil = True
    flags.error_model = "numpy"
    flags.forceinline = forced
    flags.enable_pyobject = False
    flags.boundscheck = False
    return flags


def part_of(function: inlined) -> Part:
    """The part of a kernel or an inlined function."""
    part = vars(function).get("_part")
    if part is None:
        part = function._part = Part(function.py_func, lambda args: function.py_func, function.forced)
    return part


def generic_part(stub: Callable) -> Part:
    """The part of a function with overloads: Numba compiles the first overload that knows the types."""

    def choose(args):
        homes = {getattr(getattr(arg, "instance_class", None), "__module__", None) for arg in args}
        guests = [guest for guest in guest_overloads(stub) if guest.__module__ in homes]
        for implementation in (*guests, *overloads(stub)):
            chosen = implementation(*args)
            if chosen is not None:
                return chosen
        raise TypeError(f"{stub.__qualname__} has no overload for ({', '.join(map(str, args))})")

    return Part(stub, choose, False)
