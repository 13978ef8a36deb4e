"""Numba's front end: kernels, inlined functions and overloads, compiled for argument types to LLVM IR.

Parts. A part replaces Numba's dispatcher. It omits features that kernels do not need: entry points for Python and C,
parallel loops, object mode, and reference-counted memory.

Libraries. Numba's own library optimises every function, links it with its callees and emits its machine code, which
only kernels called from Python need. Here, a library is the IR of one function and a list of the libraries it calls.

Patches. Numba types and lowers in Python, and for kernels of many small functions it spends most of that time
recomputing the same results. The patches do not change any result of Numba. They are undone afterwards, so other uses
of Numba are not affected. A patch that does not apply to the installed version is skipped.
"""

import functools
import gc
import inspect
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any, NamedTuple

import llvmlite.binding as llvm
from numba import _dynfunc  # type: ignore[attr-defined]
from numba.core import (
    cgutils,
    codegen,
    compiler,
    compiler_machinery,
    errors,
    event,
    ir,
    lowering,
    postproc,
    transforms,
    typeinfer,
    types,
    utils,
)
from numba.core import typed_passes as typed
from numba.core import untyped_passes as untyped
from numba.core.imputils import user_function
from numba.core.registry import cpu_target
from numba.core.types import functions
from numba.core.typing import templates

from ..jit import guest_overloads, inlined, overloads

# --- Patches ----------------------------------------------------------------------------------------------------------


@contextmanager
def numba_patches() -> Iterator[None]:
    """Within the context, Numba compiles faster. Call it under Numba's compiler lock."""
    with ExitStack() as changes:
        changes.enter_context(_without_garbage_collection())
        for owner, name, value in PATCHES:
            with suppress(AttributeError):
                changes.enter_context(_patched(owner, name, value))
        yield


@contextmanager
def _patched(owner: object, name: str, value: object) -> Iterator[None]:
    before = getattr(owner, name)
    setattr(owner, name, value)
    try:
        yield
    finally:
        setattr(owner, name, before)


@contextmanager
def _without_garbage_collection() -> Iterator[None]:
    """Turn off garbage collection, which takes 1/7 of the time because Numba creates many long-lived objects."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


_call_types: dict[object, tuple[object, Any]] = {}
_resolve = functions.BaseFunction.get_call_type


def _cached_call_type(self: Any, context: Any, args: Any, kws: Any) -> Any:
    """The result type of a builtin function, resolved once per list of argument types."""
    if kws:
        return _resolve(self, context, args, kws)
    cache_key = (id(self), len(self.templates), tuple(args))
    known = _call_types.get(cache_key)
    if known is None:
        known = _call_types[cache_key] = self, _resolve(self, context, args, kws)  # keeps `self` and its id alive
    return known[1]


_LEAVES = {str, int, float, bool, type(None), ir.Loc}


def _variables(values: Iterable[Any], variables: list[ir.Var]) -> list[ir.Var]:
    """Append the variables among `values` to `variables`. Values without variables are skipped."""
    for value in values:
        kind = type(value)
        if kind is ir.Var:
            variables.append(value)
        elif kind in _LEAVES:
            continue
        elif kind is list or kind is tuple:
            _variables(value, variables)
        elif kind is dict:
            _variables(value.values(), variables)
        elif isinstance(value, ir.Inst):
            variables += value.list_vars()
        elif isinstance(value, ir.Var):
            variables.append(value)
    return variables


def _list_vars(self: Any) -> list[ir.Var]:
    return _variables(vars(self).values(), [])


_post_process = postproc.PostProcessor.run


def _brief_post_process(self: Any, emit_dels: bool = False, extend_lifetimes: bool = False) -> None:
    """Numba's analysis of a function after each pass, without the live variables of blocks, which only generators need.

    Lifetimes are computed when they are read.
    """
    function = self.func_ir
    if function.is_generator:
        _post_process(self, emit_dels, extend_lifetimes)
        return
    function.blocks = transforms.canonicalize_cfg(function.blocks)
    function.variable_lifetime = postproc.VariableLifetime(function.blocks)
    function.generator_info = None
    if emit_dels:
        self._insert_var_dels(extend_lifetimes=extend_lifetimes)


class _ErrorContext:
    """Numba's `new_error_context`, which adds what was compiled to an error, as a class: generators take longer."""

    __slots__ = ("arguments", "by_name", "text")

    def __init__(self, text: str, *arguments: Any, **by_name: Any) -> None:
        self.text, self.arguments, self.by_name = text, arguments, by_name

    def __enter__(self) -> None:
        pass

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        if isinstance(error, errors.NumbaError):
            error.add_context(self.text.format(*self.arguments, **self.by_name))


def _hash_of_type(self: Any) -> int:
    """The hash of a type, computed once: keys are nested tuples."""
    known: int | None = self.__dict__.get("_antumbra_hash")
    if known is None:
        known = self.__dict__["_antumbra_hash"] = hash(self.key)
    return known


PATCHES = (
    (event, "broadcast", lambda event: None),  # nothing listens to Numba's events
    (event, "start_event", lambda kind, data=None: None),  # two for each call of LLVM
    (event, "end_event", lambda kind, data=None, exc_details=None: None),
    (functions.BaseFunction, "get_call_type", _cached_call_type),
    (ir.Stmt, "list_vars", _list_vars),
    (ir.Expr, "list_vars", _list_vars),
    (ir.Assign, "__str__", lambda self: "an assignment"),  # lowering formats each for a debugger that is off
    (postproc.PostProcessor, "run", _brief_post_process),
    (lowering, "new_error_context", _ErrorContext),
    (typeinfer, "new_error_context", _ErrorContext),
    (types.Type, "__hash__", _hash_of_type),
    (utils, "pysignature", functools.cache(inspect.signature)),
)

# --- Libraries --------------------------------------------------------------------------------------------------------


_NO_ERROR = "i32 0"


class Library(codegen.CodeLibrary):
    """The code of one function, kept as IR. It replaces Numba's own `CodeLibrary`."""

    def __init__(self, codegen: Any, name: str) -> None:
        super().__init__(codegen, name)
        self._modules: list[llvm.ModuleRef] = []
        self._callees: dict[Any, None] = {}

    def add_linking_library(self, library: Any) -> None:
        self._callees[library] = None

    def add_ir_module(self, ir_module: Any) -> None:
        module = llvm.parse_assembly(cgutils.normalize_ir_text(str(ir_module)))
        module.name = ir_module.name
        module.data_layout = self._codegen._data_layout
        _simplify(self._codegen, module)
        self._modules.append(module)

    def never_fails(self, name: str) -> bool:
        """Whether a function of this library never raises: whether it always returns the status "no error"."""
        function = self._modules[0].get_function(name)
        ends = (list(block.instructions)[-1] for block in function.blocks)
        returned = (next(end.operands) for end in ends if end.opcode == "ret")
        return all(str(value) == _NO_ERROR for value in returned)

    def linked(self, visible: str | None = None) -> llvm.ModuleRef:
        """One module of this library and of all libraries that it reaches.

        Only the function `visible` is externally visible; with None, every function is.
        """
        linked = llvm.parse_assembly(str(self._codegen._create_empty_module(self.name)))
        for library in self._closure():
            modules = library._modules if isinstance(library, Library) else [library._get_module_for_linking()]
            for module in modules:
                linked.link_in(_mergeable(module), preserve=True)
        if visible is not None:
            for value in (*linked.functions, *linked.global_variables):
                if not value.is_declaration and value.name != visible and not value.name.startswith("llvm."):
                    value.linkage = "internal"
        return linked

    def _closure(self) -> list[Any]:
        """All libraries that this one reaches, starting with itself."""
        libraries: dict[Any, None] = {self: None}
        todo: list[Any] = [self]
        while todo:
            for library in todo.pop()._callees:
                if library not in libraries:
                    libraries[library] = None
                    todo += [library] if isinstance(library, Library) else []
        return list(libraries)

    # Numba calls the methods below if a function compiled elsewhere calls one compiled here.

    def finalize(self) -> None:
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        return 0

    def _get_module_for_linking(self) -> llvm.ModuleRef:
        return self.linked()

    def get_function(self, name: str) -> llvm.ValueRef:
        return self.linked().get_function(name)

    def get_llvm_str(self) -> str:
        return str(self.linked())

    def get_asm_str(self) -> str:
        raise NotImplementedError("functions that kernels call have no machine code of their own")


def _simplify(codegen: Any, module: llvm.ModuleRef) -> None:
    """Run LLVM's function passes. Smaller IR pays off, since a function is linked into many kernels."""
    passes, builder = codegen._function_pass_manager()
    for function in module.functions:
        if not function.is_declaration:
            passes.run(function, builder)


def _mergeable(module: llvm.ModuleRef) -> llvm.ModuleRef:
    """A copy that can be linked into a module that already has the same functions."""
    copy = module.clone()
    for function in copy.functions:
        if not function.is_declaration and function.linkage == llvm.Linkage.external:
            function.linkage = "weak_odr"  # not "linkonce", which LLVM drops while nothing uses the function
    return copy


def _executable(library: Any, fndesc: Any, environment: Any) -> Any:
    """A placeholder for Numba's function that Python could call. It is never called."""
    name = fndesc.qualname.rpartition(".")[2]
    return _dynfunc.make_function(fndesc.lookup_module(), name, "", 0, environment, (library,))


@contextmanager
def ir_libraries(context: Any) -> Iterator[None]:
    """Within the context, all code that Numba compiles, including Numba's own functions, becomes a `Library`.

    Call it under Numba's compiler lock, since it changes Numba's behaviour.
    """
    codegen = context.codegen()
    codegen._library_class, context.get_executable = Library, _executable
    try:
        yield
    finally:
        del codegen._library_class, context.get_executable  # the class attributes are visible again


# --- Parts ------------------------------------------------------------------------------------------------------------


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
    (typed.IRLegalization, "legal IR"),
    (typed.NativeLowering, "lowering"),
)


class _Passes(compiler_machinery.PassManager):
    """Runs passes without Numba's timing, events and checks."""

    def _runPass(self, index: int, each: Any, state: Any) -> None:
        each.analysis = self._analysis
        for run in each.run_initialization, each.run_pass, each.run_finalizer:
            run(state)


class _Pipeline(compiler.CompilerBase):
    def define_pipelines(self) -> list[_Passes]:
        passes = _Passes("antumbra")
        for each, what in _PASSES:
            passes.add_pass(each, what)
        passes.finalize()
        return [passes]


class Lowered(NamedTuple):
    """A part compiled for argument types."""

    signature: Any  # Numba's signature
    fndesc: Any  # Numba's description of the function: name and types
    library: Library


class CompiledPart:
    """A function that other compiled functions call, and that Numba treats as a dispatcher."""

    def __init__(self, py_func: Callable[..., Any], choose: Callable[..., Any], forced: bool) -> None:
        self.py_func, self._choose, self._forced = py_func, choose, forced
        self._signature = inspect.signature(py_func)
        self.lowered: dict[tuple[Any, ...], Lowered] = {}
        self.is_compiling = 0  # read by Numba for recursive functions
        self.type: Any = types.Dispatcher(self)

    def __repr__(self) -> str:
        return self.py_func.__qualname__

    def get_call_template(self, args: Any, kws: Any) -> tuple[Any, Any, Any, dict[str, Any]]:
        """Called by Numba: the type that a call with arguments of these types returns."""
        signature, args = self.fold_argument_types(args, kws)
        lowered, name = self.lower(tuple(args)), self.py_func.__name__
        return templates.make_concrete_template(name, name, [lowered.signature]), signature, args, {}

    def fold_argument_types(self, args: Any, kws: Any) -> tuple[Any, Any]:
        """Called by Numba: the types of all arguments, given by position, by name or by default."""
        keep = lambda index, parameter, value: value
        default = lambda index, parameter, value: types.Omitted(value)
        return self._signature, templates.fold_arguments(self._signature, args, kws, keep, default, keep)

    def get_overload(self, signature: Any) -> Lowered:
        """Called by Numba: the key of the code, as given to `insert_user_function`."""
        return self.lowered[tuple(signature)]

    @property
    def nopython_signatures(self) -> list[Any]:
        return [lowered.signature for lowered in self.lowered.values()]

    def lower(self, args: tuple[Any, ...]) -> Lowered:
        """Types and LLVM IR for argument types. Call it under Numba's compiler lock, within `ir_libraries`."""
        lowered = self.lowered.get(args)
        if lowered is None:
            typing_context, context = cpu_target.typing_context, cpu_target.target_context
            library = Library(context.codegen(), self.py_func.__qualname__)
            function, flags = self._choose(args), _flags(self._forced)
            self.is_compiling += 1
            try:
                result = compiler.compile_extra(
                    typing_context, context, function, args, None, flags, {}, library, pipeline_class=_Pipeline
                )
            finally:
                self.is_compiling -= 1
            lowered = Lowered(templates.signature(result.fndesc.restype, *args), result.fndesc, library)
            implementation = _call_of(result.fndesc, library)
            context._defns[lowered].append(implementation, implementation.signature)
            self.lowered[args] = lowered
        return lowered


def _call_of(fndesc: Any, library: Library) -> Any:
    """The implementation of a call: Numba's `user_function`, without the error check if the callee never raises."""
    if isinstance(fndesc.restype, types.Optional) or not library.never_fails(fndesc.llvm_func_name):
        return user_function(fndesc, [library])

    def call(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        function = context.declare_function(builder.module, fndesc)
        _, value = context.call_conv.call_function(builder, function, fndesc.restype, fndesc.argtypes, args)
        return value

    call.signature, call.libs = fndesc.argtypes, (library,)  # type: ignore[attr-defined]
    return call


def _flags(forced: bool) -> Any:
    flags: Any = compiler.Flags()
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


def part_of(function: inlined) -> CompiledPart:
    """The part of a kernel or an inlined function."""
    part: CompiledPart | None = vars(function).get("_part")
    if part is None:
        part = vars(function)["_part"] = CompiledPart(function.py_func, lambda args: function.py_func, function.forced)
    return part


def generic_part(stub: Callable[..., Any]) -> CompiledPart:
    """The part of a function with overloads, which compiles the first overload that accepts the types."""

    def choose(args: tuple[Any, ...]) -> Callable[..., Any]:
        homes = {getattr(getattr(arg, "instance_class", None), "__module__", None) for arg in args}
        guests = [guest for guest in guest_overloads(stub) if guest.__module__ in homes]
        for implementation in (*guests, *overloads(stub)):
            chosen: Callable[..., Any] | None = implementation(*args)
            if chosen is not None:
                return chosen
        raise TypeError(f"{stub.__qualname__} has no overload for ({', '.join(map(str, args))})")

    return CompiledPart(stub, choose, False)
