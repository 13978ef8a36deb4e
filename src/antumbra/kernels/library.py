"""LLVM IR of functions that Numba has lowered, linked only for kernels that Python calls.

Numba's own library optimises every function, links it with its callees and makes machine code of it. Only kernels that
Python calls need that. Here a library is the IR of one function and a list of the libraries that it calls.
"""

from collections.abc import Iterator
from contextlib import contextmanager

import llvmlite.binding as llvm
from numba import _dynfunc
from numba.core import cgutils, codegen

_NO_ERROR = "i32 0"


class Library(codegen.CodeLibrary):
    """The code of one function, kept as IR. It takes the place of Numba's own `CodeLibrary`."""

    def __init__(self, codegen, name):
        super().__init__(codegen, name)
        self._modules: list[llvm.ModuleRef] = []
        self._callees: dict[codegen.CodeLibrary, None] = {}

    def add_linking_library(self, library):
        self._callees[library] = None

    def add_ir_module(self, ir_module):
        module = llvm.parse_assembly(cgutils.normalize_ir_text(str(ir_module)))
        module.name = ir_module.name
        module.data_layout = self._codegen._data_layout
        _simplify(self._codegen, module)
        self._modules.append(module)

    def never_fails(self, name: str) -> bool:
        """Whether a function of this library only ever returns the status "no error": it never raises."""
        function = self._modules[0].get_function(name)
        ends = (list(block.instructions)[-1] for block in function.blocks)
        returned = (next(end.operands) for end in ends if end.opcode == "ret")
        return all(str(value) == _NO_ERROR for value in returned)

    def linked(self, visible: str | None = None) -> llvm.ModuleRef:
        """One module of this library and of all libraries that it reaches.

        Only the function `visible` is visible from outside; with None, every function is.
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

    def _closure(self) -> list[codegen.CodeLibrary]:
        """All libraries that this one reaches, itself first."""
        found, todo = {self: None}, [self]
        while todo:
            for library in todo.pop()._callees:
                if library not in found:
                    found[library] = None
                    todo += [library] if isinstance(library, Library) else []
        return list(found)

    # Numba calls the methods below if a function from elsewhere calls one that was compiled here.

    def finalize(self):
        self._finalized = True

    def get_pointer_to_function(self, name):
        return 0

    def _get_module_for_linking(self):
        return self.linked()

    def get_function(self, name):
        return self.linked().get_function(name)

    def get_llvm_str(self):
        return str(self.linked())

    def get_asm_str(self):
        raise NotImplementedError("functions that kernels call have no machine code of their own")


def _simplify(codegen, module: llvm.ModuleRef) -> None:
    """Run LLVM's function passes. Smaller IR pays, since a function is linked into many kernels."""
    passes, builder = codegen._function_pass_manager()
    for function in module.functions:
        if not function.is_declaration:
            passes.run(function, builder)


def _mergeable(module: llvm.ModuleRef) -> llvm.ModuleRef:
    """A copy that can be linked into a module that already has the same functions."""
    copy = module.clone()
    for function in copy.functions:
        if not function.is_declaration and function.linkage == llvm.Linkage.external:
            function.linkage = "weak_odr"  # not "linkonce": LLVM drops that if nothing uses the function yet
    return copy


def _executable(library, fndesc, environment):
    """A placeholder for Numba's function that Python can call. Nobody calls it."""
    name = fndesc.qualname.rpartition(".")[2]
    return _dynfunc.make_function(fndesc.lookup_module(), name, "", 0, environment, (library,))


@contextmanager
def kept_as_ir(context) -> Iterator[None]:
    """Within the context, all code that Numba compiles goes into this module's libraries, Numba's own functions too.

    Call it under Numba's compiler lock, since it changes Numba's behaviour.
    """
    codegen = context.codegen()
    codegen._library_class, context.get_executable = Library, _executable
    try:
        yield
    finally:
        del codegen._library_class, context.get_executable  # the class attributes are visible again
