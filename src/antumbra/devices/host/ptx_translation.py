"""PTX translated to LLVM IR: a function that does what one thread of a kernel does.

Each register is a variable, and each instruction a few lines that read and write variables; LLVM makes values of them.
Operations that PTX rounds to nearest are LLVM's plain ones. A modifier that is not known is an error, never ignored.
"""

import re
from collections.abc import Callable
from typing import NamedTuple

from ..device import DeviceError
from .ptx_reader import Instruction, PtxKernel, bits_of

FLOATS = {"f32": "float", "f64": "double"}
_FLOAT_COMPARISONS = {
    "eq": "oeq", "ne": "one", "lt": "olt", "le": "ole", "gt": "ogt", "ge": "oge", "num": "ord",
    "equ": "ueq", "neu": "une", "ltu": "ult", "leu": "ule", "gtu": "ugt", "geu": "uge", "nan": "uno",
}  # fmt: skip
_UNSIGNED_NAMES = {"lo": "lt", "ls": "le", "hi": "gt", "hs": "ge"}
_ROUNDINGS = {"rni": "roundeven", "rzi": "trunc", "rmi": "floor", "rpi": "ceil"}
_ATOMICS = {"exch": "xchg", "add": "add", "and": "and", "or": "or", "xor": "xor"}
_SPECIAL = {"%tid.x": "%tid", "%ctaid.x": "%ctaid", "%ntid.x": "%ntid", "%nctaid.x": "%nctaid", "%laneid": "%laneid"}
_FIRST_PAGE = 4096  # no array lies below it

PARAMETERS = "ptr %words, ptr %block_memory, i32 %tid, i32 %ctaid, i32 %ntid, i32 %nctaid"
"""Parameters of a thread's function: the kernel's arguments, the memory of its block, and its place in the launch."""


class Meeting(NamedTuple):
    """A place in a kernel where threads meet."""

    what: str  # "shuffle", "ballot" or "barrier"
    line: str  # of PTX

    @property
    def of_block(self) -> bool:
        """Whether all threads of a block meet, not only those of a warp."""
        return self.what == "barrier"


class Translation:
    """The body of a thread's function.

    lines : of LLVM IR
    faults : instructions that read or write memory; a wrong address leaves its number, from 1 on, in ``@fault``
    meetings : the places where threads meet. There, the thread stores (place + 1, first word, second word) in its
        `ThreadState` and suspends; the result is read from there.
    """

    def __init__(self, kernel: PtxKernel) -> None:
        self.lines: list[str] = []
        self.faults: list[str] = []
        self.meetings: list[Meeting] = []
        self._kernel, self._count = kernel, 0
        for each in kernel.instructions:
            if not each.operation:
                self._label(each.operands[0].removeprefix("$"))
                continue
            try:
                self._guarded(each)
            except (KeyError, ValueError, IndexError) as error:
                raise DeviceError(f"the host device does not know the PTX instruction {each.line}") from error

    # Lines

    def _put(self, text: str) -> None:
        self.lines.append(f"  {text}")

    def _value(self, text: str) -> str:
        """A new value, computed by an instruction."""
        self._count += 1
        self._put(f"%v{self._count} = {text}")
        return f"%v{self._count}"

    def _call(self, name: str, kind: str, *values: str) -> str:
        """The result of one of LLVM's functions of values of one type."""
        return self._value(f"call {kind} @llvm.{name}({', '.join(f'{kind} {value}' for value in values)})")

    def _new_block(self) -> str:
        """The name of a new block."""
        self._count += 1
        return f"b{self._count}"

    def _label(self, name: str) -> None:
        self._put(f"br label %{name}")
        self._start(name)

    def _start(self, block: str) -> None:
        self.lines.append(f"{block}:")

    # Registers and memory

    def _read(self, operand: str, width: int) -> str:
        """The bits of a register, a constant, a special register, or the address of an array."""
        if operand in _SPECIAL:
            return self._resized(_SPECIAL[operand], 32, width)
        if constant := re.fullmatch(r"0([fd])([0-9A-F]{8}|[0-9A-F]{16})", operand):
            _require(width == len(constant[2]) * 4 == {"f": 32, "d": 64}[constant[1]])
            return str(int(constant[2], 16))
        if re.fullmatch(r"-?\d+", operand):
            return str(int(operand)) if width > 1 else str(bool(int(operand))).lower()
        if operand in self._kernel.own_memory or operand in self._kernel.block_memory:
            return self._resized(self._value(f"ptrtoint ptr %memory.{operand} to i64"), 64, width)
        have = self._kernel.registers[operand]
        return self._resized(self._value(f"load i{have}, ptr {operand}.r"), have, width)

    def _resized(self, value: str, have: int, width: int) -> str:
        _require(have >= width)
        return value if have == width else self._value(f"trunc i{have} {value} to i{width}")

    def _write(self, register: str, value: str, width: int, signed: bool = False) -> None:
        """Write bits to a register, which may be wider."""
        if register == "_":
            return
        have = self._kernel.registers[register]
        _require(have >= width)
        if have > width:
            value = self._value(f"{'sext' if signed else 'zext'} i{width} {value} to i{have}")
        self._put(f"store i{have} {value}, ptr {register}.r")

    def _read_float(self, operand: str, kind: str) -> str:
        width = bits_of(kind)
        return self._value(f"bitcast i{width} {self._read(operand, width)} to {FLOATS[kind]}")

    def _write_float(self, register: str, value: str, kind: str) -> None:
        width = bits_of(kind)
        self._write(register, self._value(f"bitcast {FLOATS[kind]} {value} to i{width}"), width)

    def _address(self, operand: str) -> str:
        """The pointer of ``[register+offset]`` or ``[array+offset]``."""
        base, _, offset = operand[1:-1].partition("+")
        place = self._read(base, 64)
        if offset:
            place = self._value(f"add i64 {place}, {int(offset)}")
        return self._value(f"inttoptr i64 {place} to ptr")

    def _check_address(self, pointer: str, alignment: int, each: Instruction) -> None:
        """End the thread, and leave the number of the fault, where a card would fault."""
        self.faults.append(each.line)
        number = self._value(f"ptrtoint ptr {pointer} to i64")
        odd = self._value(f"and i64 {number}, {alignment - 1}")
        misaligned = self._value(f"icmp ne i64 {odd}, 0")
        null = self._value(f"icmp ult i64 {number}, {_FIRST_PAGE}")
        wrong, fault, right = self._value(f"or i1 {misaligned}, {null}"), self._new_block(), self._new_block()
        self._put(f"br i1 {wrong}, label %{fault}, label %{right}")
        self._start(fault)
        self._put(f"store i32 {len(self.faults)}, ptr @fault")
        self._put("br label %ended")
        self._start(right)

    # Control

    def _guarded(self, each: Instruction) -> None:
        """An instruction, executed if its predicate holds."""
        if each.predicate is None:
            self._translated(each)
            return
        condition, execute, after = self._read(each.predicate, 1), self._new_block(), self._new_block()
        yes, no = (after, execute) if each.negated else (execute, after)
        self._put(f"br i1 {condition}, label %{yes}, label %{no}")
        self._start(execute)
        self._translated(each)
        self._label(after)

    def _translated(self, each: Instruction) -> None:
        name = each.operation[0]
        of_floats, of_others = _BY_KIND.get(name, (None, None))
        translate = _BY_NAME.get(name) or (of_floats if each.kind in FLOATS else of_others)
        if translate is None:
            raise KeyError(name)
        translate(self, each)

    def _branch(self, each: Instruction) -> None:
        _require(each.operation in (("bra",), ("bra", "uni")))
        self._put(f"br label %{each.operands[0].removeprefix('$')}")
        self._start(self._new_block())

    def _return(self, each: Instruction) -> None:
        _require(len(each.operation) == 1)
        self._put("br label %ended")
        self._start(self._new_block())

    # Moves

    def _move(self, each: Instruction) -> None:
        """`mov`, also between a register and the halves of it; `cvta`, since all memory has one space here."""
        to, source = each.operands
        _require(each.operation[0] == "cvta" or len(each.operation) == 2)
        width = bits_of(each.kind)
        if to.startswith("{"):
            low, high = _listed(to)
            value = self._read(source, width)
            shifted = self._value(f"lshr i{width} {value}, {width // 2}")
            for register, part in (low, value), (high, shifted):
                self._write(register, self._resized(part, width, width // 2), width // 2)
        elif source.startswith("{"):
            parts = [self._read(part, width // 2) for part in _listed(source)]
            low, high = (self._value(f"zext i{width // 2} {part} to i{width}") for part in parts)
            shifted = self._value(f"shl i{width} {high}, {width // 2}")
            self._write(to, self._value(f"or i{width} {low}, {shifted}"), width)
        else:
            self._write(to, self._read(source, width), width)

    def _select(self, each: Instruction) -> None:
        _require(len(each.operation) == 2)
        to, yes, no, condition = each.operands
        width = bits_of(each.kind)
        a, b, chosen = self._read(yes, width), self._read(no, width), self._read(condition, 1)
        self._write(to, self._value(f"select i1 {chosen}, i{width} {a}, i{width} {b}"), width)

    def _memory(self, each: Instruction) -> None:
        """`ld` and `st`, of up to four elements; of a parameter, from the words of the launch."""
        loads, width = each.operation[0] == "ld", bits_of(each.kind)
        registers, place = each.operands if loads else each.operands[::-1]
        counts = {"v2": 2, "v4": 4}
        modifiers = set(each.operation[1:-1])
        _require(modifiers <= {"param", "global", "local", "shared", "nc", *counts})
        names = _listed(registers) if registers.startswith("{") else [registers]
        _require(len(names) == next((counts[each] for each in modifiers if each in counts), 1))
        pointer = self._parameter(place) if "param" in modifiers else self._address(place)
        if "global" in modifiers or "shared" in modifiers:
            self._check_address(pointer, width // 8 * len(names), each)
        for k, name in enumerate(names):
            at = self._value(f"getelementptr i8, ptr {pointer}, i64 {k * width // 8}")
            align = min(width // 8 * len(names), 16) if k == 0 else width // 8
            if loads:
                value = self._value(f"load i{width}, ptr {at}, align {align}")
                self._write(name, value, width, each.kind[0] == "s")
            else:
                self._put(f"store i{width} {self._read(name, width)}, ptr {at}, align {align}")

    def _parameter(self, operand: str) -> str:
        name, _, offset = operand[1:-1].partition("+")
        place = 8 * self._kernel.parameters.index(name) + int(offset or 0)
        return self._value(f"getelementptr i8, ptr %words, i64 {place}")

    def _atomic(self, each: Instruction) -> None:
        """`atom`, and `red`, which has no result."""
        *modifiers, operation, kind = each.operation[1:]
        _require(set(modifiers) <= {"global", "shared", "relaxed", "gpu", "sys"})
        to, place, *values = each.operands if each.operation[0] == "atom" else ("_", *each.operands)
        width = bits_of(kind)
        pointer, numbers = self._address(place), [self._read(value, width) for value in values]
        self._check_address(pointer, width // 8, each)
        if operation == "cas":
            pair = self._value(f"cmpxchg ptr {pointer}, i{width} {numbers[0]}, i{width} {numbers[1]} seq_cst seq_cst")
            old = self._value(f"extractvalue {{ i{width}, i1 }} {pair}, 0")
        else:
            names = _ATOMICS | ({"min": "umin", "max": "umax"} if kind[0] == "u" else {"min": "min", "max": "max"})
            old = self._value(f"atomicrmw {names[operation]} ptr {pointer}, i{width} {numbers[0]} seq_cst")
        self._write(to, old, width)

    # Floats

    def _float_arithmetic(self, each: Instruction) -> None:
        """Operations that round to nearest."""
        name, kind = each.operation[0], each.kind
        _require(each.operation[1:-1] == ("rn",))
        form, values = FLOATS[kind], [self._read_float(operand, kind) for operand in each.operands[1:]]
        _require(len(values) == {"fma": 3, "rcp": 1, "sqrt": 1}.get(name, 2))
        if name in ("fma", "sqrt"):
            result = self._call(f"{name}.{kind}", form, *values)
        elif name == "rcp":
            result = self._value(f"fdiv {form} 1.0, {values[0]}")
        else:
            result = self._value(f"f{name} {form} {values[0]}, {values[1]}")
        self._write_float(each.operands[0], result, kind)

    def _float_choice(self, each: Instruction) -> None:
        """`min` and `max`, in which a number wins over NaN and -0 is less than 0; `neg`, `abs` and `copysign`."""
        name, kind = each.operation[0], each.kind
        _require(len(each.operation) == 2)
        form, values = FLOATS[kind], [self._read_float(operand, kind) for operand in each.operands[1:]]
        if name == "neg":
            result = self._value(f"fneg {form} {values[0]}")
        else:
            names = {"abs": "fabs", "copysign": "copysign"}
            values = values[::-1] if name == "copysign" else values
            result = self._call(f"{names.get(name, f'{name}imumnum')}.{kind}", form, *values)
        self._write_float(each.operands[0], result, kind)

    def _compare(self, each: Instruction) -> None:
        name, comparison, kind = each.operation
        to, *operands = each.operands
        _require(name == "setp" and len(operands) == 2)
        if kind in FLOATS:
            a, b = (self._read_float(operand, kind) for operand in operands)
            result = self._value(f"fcmp {_FLOAT_COMPARISONS[comparison]} {FLOATS[kind]} {a}, {b}")
        else:
            a, b = (self._read(operand, bits_of(kind)) for operand in operands)
            comparison = _UNSIGNED_NAMES.get(comparison, comparison)
            sign = "" if comparison in ("eq", "ne") else "s" if kind[0] == "s" else "u"
            result = self._value(f"icmp {sign}{comparison} i{bits_of(kind)} {a}, {b}")
        self._write(to, result, 1)

    def _convert(self, each: Instruction) -> None:
        *how, to, source = each.operation[1:]
        target, operand = each.operands
        if to in FLOATS and source in FLOATS:
            value = self._read_float(operand, source)
            if to == source:
                value = self._call(f"{_ROUNDINGS[how[0]]}.{to}", FLOATS[to], value)
            else:
                _require(how == ([] if to > source else ["rn"]))
                cast = "fpext" if to > source else "fptrunc"
                value = self._value(f"{cast} {FLOATS[source]} {value} to {FLOATS[to]}")
            self._write_float(target, value, to)
        elif to in FLOATS:
            _require(how == ["rn"])
            width = bits_of(source)
            value = self._value(f"{source[0]}itofp i{width} {self._read(operand, width)} to {FLOATS[to]}")
            self._write_float(target, value, to)
        elif source in FLOATS:
            self._truncate(target, operand, how, to, source)
        else:
            _require(not how)
            a, b = bits_of(source), bits_of(to)
            value = self._read(operand, a)
            if b > a:
                value = self._value(f"{'sext' if source[0] == 's' else 'zext'} i{a} {value} to i{b}")
            self._write(target, self._resized(value, max(a, b), b), b, to[0] == "s")

    def _truncate(self, target: str, operand: str, how: list[str], to: str, source: str) -> None:
        """A float to an integer: it saturates, and NaN gives 0."""
        value, width = self._read_float(operand, source), bits_of(to)
        value = self._call(f"{_ROUNDINGS[how[0]]}.{source}", FLOATS[source], value)
        name = f"llvm.fpto{to[0]}i.sat.i{width}.{source}"
        result = self._value(f"call i{width} @{name}({FLOATS[source]} {value})")
        self._write(target, result, width, to[0] == "s")

    # Integers

    def _integer_arithmetic(self, each: Instruction) -> None:
        name, width = each.operation[0], bits_of(each.kind)
        _require(len(each.operation) == 2)
        values = [self._read(operand, width) for operand in each.operands[1:]]
        unary = {"neg": "sub i{w} 0, {a}", "not": "xor i{w} {a}, -1"}
        if name in unary:
            result = self._value(unary[name].format(w=width, a=values[0]))
        elif name in ("min", "max"):
            result = self._call(f"{'s' if each.kind[0] == 's' else 'u'}{name}.i{width}", f"i{width}", *values)
        elif name == "abs":
            result = self._value(f"call i{width} @llvm.abs.i{width}(i{width} {values[0]}, i1 false)")
        else:
            sign = ("s" if each.kind[0] == "s" else "u") if name in ("div", "rem") else ""
            result = self._value(f"{sign}{name} i{width} {values[0]}, {values[1]}")
        self._write(each.operands[0], result, width)

    def _multiply(self, each: Instruction) -> None:
        """`mul` and `mad`: the low or high half of the product, or all of it."""
        name, part, kind = each.operation
        width, extend = bits_of(kind), "sext" if kind[0] == "s" else "zext"
        a, b = (self._read(operand, width) for operand in each.operands[1:3])
        _require(part in ("lo", "hi", "wide"))
        if part == "lo":
            result = self._value(f"mul i{width} {a}, {b}")
        else:
            a, b = (self._value(f"{extend} i{width} {x} to i{2 * width}") for x in (a, b))
            result = self._value(f"mul i{2 * width} {a}, {b}")
            if part == "hi":
                high = self._value(f"lshr i{2 * width} {result}, {width}")
                result = self._resized(high, 2 * width, width)
        width = 2 * width if part == "wide" else width
        if name == "mad":
            result = self._value(f"add i{width} {result}, {self._read(each.operands[3], width)}")
        self._write(each.operands[0], result, width)

    def _shift(self, each: Instruction) -> None:
        """`shl` and `shr`. A shift by the width or more leaves only sign bits, or zeros."""
        name, kind = each.operation
        width = bits_of(kind)
        value, by = self._read(each.operands[1], width), self._read(each.operands[2], 32)
        operation = "shl" if name == "shl" else "ashr" if kind[0] == "s" else "lshr"
        wide = self._value(f"zext i32 {by} to i64")
        large = self._value(f"icmp uge i64 {wide}, {width}")
        amount = self._resized(self._value(f"select i1 {large}, i64 {width - 1}, i64 {wide}"), 64, width)
        result = self._value(f"{operation} i{width} {value}, {amount}")
        if operation != "ashr":
            result = self._value(f"select i1 {large}, i{width} 0, i{width} {result}")
        self._write(each.operands[0], result, width)

    def _funnel_shift(self, each: Instruction) -> None:
        """`shf.l.wrap` and `shf.r.wrap`: 32 of the 64 bits of two registers."""
        _require(each.operation[1] in ("l", "r") and each.operation[2:] == ("wrap", "b32"))
        low, high, by = (self._read(operand, 32) for operand in each.operands[1:])
        self._write(each.operands[0], self._call(f"fsh{each.operation[1]}.i32", "i32", high, low, by), 32)

    def _extract_bits(self, each: Instruction) -> None:
        """`bfe`, of bits whose place and number are constants: a shift to the left, and one to the right."""
        width = bits_of(each.kind)
        place, count = (int(operand) for operand in each.operands[2:])
        _require(len(each.operation) == 2 and place >= 0 < count and place + count <= width)
        shifted = self._value(f"shl i{width} {self._read(each.operands[1], width)}, {width - place - count}")
        right = "ashr" if each.kind[0] == "s" else "lshr"
        self._write(each.operands[0], self._value(f"{right} i{width} {shifted}, {width - count}"), width)

    def _count_bits(self, each: Instruction) -> None:
        name, width = each.operation[0], bits_of(each.kind)
        _require(len(each.operation) == 2)
        value = self._read(each.operands[1], width)
        function = {"popc": "ctpop", "clz": "ctlz", "brev": "bitreverse"}[name]
        more = ", i1 false" if name == "clz" else ""
        result = self._value(f"call i{width} @llvm.{function}.i{width}(i{width} {value}{more})")
        width_of_result = width if name == "brev" else 32
        self._write(each.operands[0], self._resized(result, width, width_of_result), width_of_result)

    # Meetings

    def _shuffle(self, each: Instruction) -> None:
        to, value, lane, clamp, members = each.operands
        _require(each.operation == ("shfl", "sync", "idx", "b32") and (clamp, members) == ("31", "-1"))
        self._write(to, self._met("shuffle", each, self._read(value, 32), self._read(lane, 32)), 32)

    def _vote(self, each: Instruction) -> None:
        to, condition, members = each.operands
        _require(each.operation == ("vote", "sync", "ballot", "b32") and members == "-1")
        word = self._value(f"zext i1 {self._read(condition, 1)} to i32")
        self._write(to, self._met("ballot", each, word, "0"), 32)

    def _barrier(self, each: Instruction) -> None:
        _require(each.operation in (("bar", "sync"), ("barrier", "sync", "aligned")) and each.operands == ("0",))
        self._met("barrier", each, "0", "0")

    def _met(self, what: str, each: Instruction, *words: str) -> str:
        """Suspend the thread at a meeting; the word that it returns."""
        self.meetings.append(Meeting(what, each.line))
        for k, word in enumerate((str(len(self.meetings)), *words)):
            self._put(f"store i32 {word}, ptr %state.{k}")
        resumed = self._new_block()
        told = self._value("call i8 @llvm.coro.suspend(token none, i1 false)")
        self._put(f"switch i8 {told}, label %suspended [i8 0, label %{resumed} i8 1, label %ended]")
        self._start(resumed)
        return self._value("load i32, ptr %state.3")


def _require(condition: bool) -> None:
    """Raise ValueError for an instruction that is not known."""
    if not condition:
        raise ValueError


def _listed(operand: str) -> list[str]:
    """The registers of an operand in braces."""
    return re.findall(r"[^{},\s]+", operand)


_Translator = Callable[[Translation, Instruction], None]
_BY_KIND: dict[str, tuple[_Translator | None, _Translator | None]] = {
    "add": (Translation._float_arithmetic, Translation._integer_arithmetic),
    "sub": (Translation._float_arithmetic, Translation._integer_arithmetic),
    "mul": (Translation._float_arithmetic, Translation._multiply),
    "div": (Translation._float_arithmetic, Translation._integer_arithmetic),
    "neg": (Translation._float_choice, Translation._integer_arithmetic),
    "abs": (Translation._float_choice, Translation._integer_arithmetic),
    "min": (Translation._float_choice, Translation._integer_arithmetic),
    "max": (Translation._float_choice, Translation._integer_arithmetic),
    "fma": (Translation._float_arithmetic, None),
    "rcp": (Translation._float_arithmetic, None),
    "sqrt": (Translation._float_arithmetic, None),
    "copysign": (Translation._float_choice, None),
    **dict.fromkeys(("and", "or", "xor", "not", "rem"), (None, Translation._integer_arithmetic)),
    **dict.fromkeys(("popc", "clz", "brev"), (None, Translation._count_bits)),
    **dict.fromkeys(("shl", "shr"), (None, Translation._shift)),
    "bfe": (None, Translation._extract_bits),
    "mad": (None, Translation._multiply),
    "shf": (None, Translation._funnel_shift),
}
"""Operations of floats, and of everything else."""

_BY_NAME: dict[str, _Translator] = {
    "bra": Translation._branch,
    "ret": Translation._return,
    "exit": Translation._return,
    "mov": Translation._move,
    "cvta": Translation._move,
    "selp": Translation._select,
    "ld": Translation._memory,
    "st": Translation._memory,
    "atom": Translation._atomic,
    "red": Translation._atomic,
    "setp": Translation._compare,
    "cvt": Translation._convert,
    "shfl": Translation._shuffle,
    "vote": Translation._vote,
    "bar": Translation._barrier,
    "barrier": Translation._barrier,
}
