"""Device code: PTX or SPIR-V of a kernel, from the installed package, from the user's cache, or compiled.

Both forms come from one module of LLVM's (`device_ir`), so they are compiled together. The user's cache keeps them like
machine code: the form takes the place of the processor's level. A driver compiles them for its card.
"""

from functools import cache
from hashlib import blake2b
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

from ...base.errors import InputError
from ..jit import kernel
from ..marshalling import NONE, flatten, struct_of, text_of
from ..processor import LIBRARIES
from .kernel_cache import KernelCode, KernelFolder, cache_folder, symbol_of
from .kernel_digest import kernel_digest, module_digest
from .kernel_library import LibraryList, name_of
from .kernel_loading import has_compiler

Form: TypeAlias = Literal["ptx", "spirv"]
FORMS: tuple[Form, ...] = get_args(Form)
"""PTX is for NVIDIA's cards, SPIR-V for drivers of OpenCL."""


class DeviceCode(NamedTuple):
    """Code of a kernel for a driver of devices."""

    form: Form
    entry: str  # name of the kernel in `code`
    words: int  # number of its arguments, each an int64: `marshalling.flatten`
    code: bytes  # text of PTX, or SPIR-V
    digest: str  # of the kernel and of what compiled it; the entry's name contains it


class DeviceKernel(NamedTuple):
    """A device kernel, and examples of the arguments that its callers pass."""

    kernel: kernel
    arguments: tuple[Any, ...]  # of the right kinds; values do not matter

    @property
    def name(self) -> str:
        """The function's name; several kernels may share it."""
        return self.kernel.__qualname__

    @property
    def key(self) -> str:
        """The kinds of the arguments."""
        return text_of(flatten(self.arguments)[0])

    def code(self, form: Form) -> DeviceCode:
        """The code in a form."""
        return _code(self.kernel, self.key, form)

    def is_on_disk(self) -> bool:
        """Whether the code in all forms is in the installed package or in the user's cache."""
        name, key = self.kernel.name, self.key
        if all(_shipped(name, key, form) for form in FORMS):
            return True
        return has_compiler() and all(folder.has(_digest(self.kernel, key)) for folder in _folders().values())


def device_code(function: kernel, arguments: tuple[Any, ...], form: Form) -> DeviceCode:
    """The code of a kernel in a form, loaded or compiled.

    Parameters
    ----------
    function : kernel
        It returns nothing, and may use the intrinsics of `antumbra.kernels.device`.
    arguments : tuple
        Examples of its arguments. Addresses are numbers.
    form : {"ptx", "spirv"}

    Raises
    ------
    InputError
        If the kernel must be compiled, and Numba or llvmlite is missing.
    TypeError
        If the kernel does something that devices cannot.
    """
    return DeviceKernel(function, arguments).code(form)


@cache
def _code(function: kernel, key: str, form: Form) -> DeviceCode:
    return _shipped(function.name, key, form) or load_or_compile_forms(function, key)[form]


# --- The installed package --------------------------------------------------------------------------------------------


DEVICE_LIBRARY = LIBRARIES / "devices"
"""The folder of device code in an installed package: a file for each kernel and form, and their `LibraryList`."""


@cache
def _installed_list() -> LibraryList | None:
    return LibraryList.installed(DEVICE_LIBRARY)


def _shipped(name: str, key: str, form: Form) -> DeviceCode | None:
    """The code in the installed package; None if it lacks the kernel, or is damaged."""
    contents = _installed_list()
    entry = contents and contents.kernels.get(name_of(name, key))
    if not entry:
        return None
    try:
        code = (DEVICE_LIBRARY / f"{entry.symbol}.{form}").read_bytes()
    except OSError:
        return None
    return _described(form, key, entry.symbol, code) if entry.symbol.encode() in code else None


# --- The user's cache, and the compiler -------------------------------------------------------------------------------


_COMPILER = "address_spaces", "device_emission", "device_ir", "ptx_target", "spirv_target"


def _folders() -> dict[Form, KernelFolder]:
    """The folders of the user's cache."""
    return {form: KernelFolder(cache_folder(), form) for form in FORMS}


def _digest(function: kernel, key: str) -> str:
    """The digest of a kernel's device code, which is also of the modules that make it."""
    digest = blake2b(kernel_digest(function, key).encode(), digest_size=16)
    for name in _COMPILER:
        digest.update(module_digest(f"{__package__}.{name}").encode())
    return digest.hexdigest()


def _described(form: Form, key: str, entry: str, code: bytes) -> DeviceCode:
    words = struct_of(tuple(key.split())).size // 8
    return DeviceCode(form, entry, words, code, entry.removeprefix(symbol_of("")))


def load_or_compile_forms(function: kernel, key: str) -> dict[Form, DeviceCode]:
    """The code in all forms. If it has been compiled here, it is in the user's cache afterwards."""
    if not has_compiler():
        raise InputError(
            f"{function.name} is not among the device kernels of this installation, so it needs a compiler: "
            "pip install 'antumbra[jit]'"
        )
    digest = _digest(function, key)
    entry, folders = symbol_of(digest), _folders()
    codes = _cached(digest, folders)
    if codes is None:
        try:
            with folders[FORMS[0]].lock(digest):  # another process may be compiling it
                codes = _cached(digest, folders) or _compiled(function, key, entry)
                for form, folder in folders.items():
                    folder.put(digest, KernelCode(function.name, key, NONE, codes[form]))
        except OSError:  # the folder is not writable: the code is compiled each time
            codes = codes or _compiled(function, key, entry)
    return {form: _described(form, key, entry, codes[form]) for form in FORMS}


def _cached(digest: str, folders: dict[Form, KernelFolder]) -> dict[Form, bytes] | None:
    """The code in the user's cache; None unless it has all forms."""
    found = {form: folder.get(digest) for form, folder in folders.items()}
    codes: dict[Form, bytes] = {form: code.machine for form, code in found.items() if code is not None}
    return codes if len(codes) == len(FORMS) else None


def _compiled(function: kernel, key: str, entry: str) -> dict[Form, bytes]:
    """The code of a kernel in all forms, compiled here."""
    from .device_emission import EmissionError, emit_modules
    from .device_ir import device_ir
    from .ptx_target import ptx_module
    from .spirv_target import spirv_module

    assembly = device_ir(function, key, entry)
    try:
        ptx, spirv = emit_modules([ptx_module(assembly, entry), spirv_module(assembly, entry)])
    except EmissionError as error:
        raise EmissionError(f"{function.name} needs something that devices lack: {error}") from None
    return {"ptx": ptx, "spirv": spirv}
