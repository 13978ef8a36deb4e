"""Address spaces: from pointers to anything, as Numba makes them, to pointers that name the memory they point to.

Devices read memory of the whole launch, of a block and of a thread by different instructions. Numba's pointers do not
tell which, but the IR of a device kernel does once everything is inlined: a pointer made from an integer is global, one
from `alloca` is a thread's own, and one from `antumbra.kernels.device.local_*` is a block's. All other pointers have
the space of what they are computed from.
"""

import re
from collections.abc import Iterator

from ..device.operations import LOCAL

OWN, GLOBAL, LOCAL_MEMORY = 0, 1, 3
"""LLVM's numbers, the same for NVPTX and SPIR-V."""

_NAME = r'[%@](?:[\w.$-]+|"[^"]*")'
_DEFINED = re.compile(rf"\s*({_NAME}) = (.*)")
_USED = re.compile(rf"\bptr ({_NAME})")
_MERGED = re.compile(r"(?:phi|select|freeze|getelementptr|icmp)\b")
_LOCAL_CALL = re.compile(rf"call .*@{re.escape(LOCAL)}(\d+)\.(\d+)\(")
_HINT = re.compile(r"call void @llvm\.(?:lifetime|prefetch)\.")
_BLOCK_MEMORY = "@antumbra_local"


class _Sets:
    """Disjoint sets of names, joined one by one."""

    def __init__(self) -> None:
        self._parents: dict[str, str] = {}

    def root(self, name: str) -> str:
        while (parent := self._parents.get(name, name)) != name:
            name = parent
        return name

    def join(self, a: str, b: str) -> None:
        self._parents[self.root(a)] = self.root(b)


def _merged_pointers(text: str) -> list[str]:
    """The pointers of an instruction that all point to one kind of memory."""
    operation = text.split(maxsplit=1)[0]
    if operation == "phi":
        return re.findall(rf"\[ ({_NAME}),", text)
    if operation == "icmp":
        return re.findall(rf"[ ,]({_NAME})", text)
    return _USED.findall(text)


def _spaces(lines: list[str]) -> dict[str, int]:
    """Pointer -> its space, for all pointers that a function's instructions define."""
    sets, roots, pointers = _Sets(), dict[str, int](), list[str]()
    for line in lines:
        defined = _DEFINED.match(line)
        name, text = defined.groups() if defined else ("", line.strip())
        merges = _MERGED.match(text)
        if merges and "ptr" in text:
            joined = _merged_pointers(text)
            if not text.startswith("icmp"):
                pointers.append(name)
                joined.append(name)
            for other in joined[1:]:
                sets.join(other, joined[0])
            continue
        space = _root_space(text)
        if space is not None:
            pointers.append(name)
            roots[name] = space
    found: dict[str, int] = {}
    for name, space in roots.items():
        if found.setdefault(sets.root(name), space) != space:
            raise TypeError("a pointer of a device kernel may point to memory of two kinds")
    return {name: found.get(sets.root(name), GLOBAL) for name in pointers}


def _root_space(text: str) -> int | None:
    """The space of a pointer that an instruction makes; None if it makes none."""
    if re.match(r"inttoptr .* to ptr", text):
        return GLOBAL
    if text.startswith("alloca "):
        return OWN
    if _LOCAL_CALL.search(text):
        return LOCAL_MEMORY
    if re.match(r"(?:tail )?(?:call|load) (?:[\w()]+ )*ptr\b", text):
        raise TypeError(f"a device kernel keeps a pointer in memory, where its kind is not known: {text}")
    return None


def _typed(space: int) -> str:
    return f"ptr addrspace({space})" if space else "ptr"


def _rewritten(line: str, spaces: dict[str, int], globals_used: dict[str, int]) -> str:
    """A line whose pointers name their spaces."""
    defined = _DEFINED.match(line)
    name, text = defined.groups() if defined else ("", line)
    if local := _LOCAL_CALL.search(text):
        first, size = map(int, local.groups())
        globals_used[_BLOCK_MEMORY] = max(globals_used.get(_BLOCK_MEMORY, 0), first + size)
        return f"  {name} = getelementptr i8, {_typed(LOCAL_MEMORY)} {_BLOCK_MEMORY}, i64 {first}"
    own = spaces.get(name, OWN)
    if text.startswith("inttoptr"):
        return re.sub(r" to ptr\b", f" to {_typed(own)}", line)
    if text.startswith("phi ptr"):
        return line.replace("phi ptr", f"phi {_typed(own)}", 1)
    used = [spaces.get(each, OWN) for each in _USED.findall(text)]
    line = _USED.sub(lambda match: f"{_typed(spaces.get(match[1], OWN))} {match[1]}", line)
    line = re.sub(r"\bptr (null|poison|undef)\b", rf"{_typed(max([own, *used]))} \1", line)
    return re.sub(r"(@llvm\.mem\w+)((?:\.p0)+)", lambda match: match[1] + "".join(f".p{k}" for k in used), line)


def with_address_spaces(assembly: str) -> str:
    """LLVM assembly of one function, with the space of each pointer in its type.

    Raises
    ------
    TypeError
        If a pointer may point to memory of two kinds, or has been kept in memory.
    """
    lines = [line for line in assembly.splitlines() if not _HINT.search(line)]
    body = list(_body(lines))
    spaces, globals_used = _spaces([lines[k] for k in body]), dict[str, int]()
    for k in body:
        lines[k] = _rewritten(lines[k], spaces, globals_used)
    text = "\n".join(line for line in lines if LOCAL not in line)
    for name, size in globals_used.items():
        text += f"\n{name} = internal addrspace({LOCAL_MEMORY}) global [{size} x i8] undef, align 16\n"
    return text + _declarations(text)


def _body(lines: list[str]) -> Iterator[int]:
    """The places of the instructions of the only function."""
    first = next(k for k, line in enumerate(lines) if line.startswith("define "))
    last = next(k for k in range(first, len(lines)) if lines[k] == "}")
    return iter(range(first + 1, last))


_PARAMETERS = {"llvm.memcpy": "{}, {}, i64, i1", "llvm.memmove": "{}, {}, i64, i1", "llvm.memset": "{}, i8, i64, i1"}


def _declarations(text: str) -> str:
    """Declarations of LLVM's functions for memory, which bear the spaces of their pointers in their names."""
    called = set(re.findall(r"call void @(llvm\.mem\w+)((?:\.p\d)+)\.i64", text))
    declared = set(re.findall(r"declare void @(llvm\.mem\w+)((?:\.p\d)+)\.i64", text))
    made = [""]
    for name, spaces in sorted(called - declared):
        pointers = [_typed(int(space)) for space in re.findall(r"\d", spaces)]
        made.append(f"declare void @{name}{spaces}.i64({_PARAMETERS[name].format(*pointers)})")
    return "\n".join([*made, ""])
