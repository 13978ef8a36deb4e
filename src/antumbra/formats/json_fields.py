"""Checked access to the fields of JSON objects. Every error names the file, the field and the expected value."""

import json
import math
from typing import Any, NoReturn, TypeVar

import numpy as np

from ..base.errors import InputError

T = TypeVar("T")

REQUIRED = object()
_MAX_WHOLE = 2**53


class Fields:
    """One JSON object; `where` names it in errors, such as ``a.glb: nodes[3] "Door"``."""

    __slots__ = ("_data", "where")

    def __init__(self, data: object, where: str) -> None:
        if not isinstance(data, dict):
            raise InputError(f"{where} is {_description(data)}; it must be a JSON object")
        self._data = data
        self.where = where

    @property
    def data(self) -> dict[str, Any]:
        """The JSON object itself."""
        return self._data

    def place(self, key: str) -> str:
        """The name of the field `key` in errors."""
        return f"{self.where} {key}" if self.where.endswith(":") else f"{self.where}.{key}"

    def __contains__(self, key: str) -> bool:
        return self._data.get(key) is not None

    def whole(self, key: str, default: Any = REQUIRED, *, low: int = 0, high: int = _MAX_WHOLE) -> Any:
        """A whole number, low <= value < high."""
        value = self._value(key, default, "a whole number")
        if value is default:
            return default
        return self._whole(value, key, low, high)

    def number(self, key: str, default: Any = REQUIRED) -> Any:
        """A finite number."""
        value = self._value(key, default, "a number")
        return default if value is default else self._number(value, key)

    def numbers(self, key: str, length: int | None, default: Any = REQUIRED) -> Any:
        """A list of finite numbers as float64, of the given length; None: any length."""
        value = self._value(key, default, "a list of numbers")
        if value is default:
            return default
        if not isinstance(value, list) or (length is not None and len(value) != length):
            count_text = "" if length is None else f"{length} "
            raise self.bad(key, f"a list of {count_text}numbers")
        return np.array([self._number(v, key) for v in value], np.float64)

    def indices(self, key: str, count: int) -> list[int]:
        """A list of whole numbers below `count`; empty if the field is missing."""
        value = self._value(key, None, "a list")
        if value is None:
            return []
        if not isinstance(value, list):
            raise self.bad(key, "a list of whole numbers")
        return [self._whole(v, key, 0, count) for v in value]

    def flag(self, key: str) -> bool:
        return self._value(key, False, "true or false") is True

    def text(self, key: str, default: Any = REQUIRED) -> Any:
        value = self._value(key, default, "text")
        if value is not default and not isinstance(value, str):
            raise self.bad(key, "text")
        return value

    def texts(self, key: str) -> list[str]:
        value = self._value(key, [], "a list of texts")
        if not isinstance(value, list) or not all(isinstance(v, str) for v in value):
            raise self.bad(key, "a list of texts")
        return value

    def object(self, key: str) -> "Fields | None":
        value = self._value(key, None, "an object")
        return None if value is None else Fields(value, self.place(key))

    def objects(self, key: str) -> "list[Fields]":
        """A list of JSON objects; empty if the field is missing."""
        value = self._value(key, None, "a list")
        if value is None:
            return []
        if not isinstance(value, list):
            raise self.bad(key, "a list of objects")
        return [Fields(v, f"{self.place(key)}[{i}]{_name(v)}") for i, v in enumerate(value)]

    def raw(self, key: str, kind: type[T], expected: str) -> T:
        """A value of type `kind` as parsed; an empty one if the field is missing."""
        value = self._value(key, kind(), expected)
        if not isinstance(value, kind):
            raise self.bad(key, expected)
        return value

    def mapping(self, key: str, count: int) -> dict[str, int]:
        """An object whose values are whole numbers below `count`, as {name: number}."""
        fields = self.object(key)
        return {} if fields is None else {k: fields.whole(k, high=count) for k in fields._data}

    def extension(self, name: str) -> "Fields | None":
        extensions = self.object("extensions")
        return None if extensions is None else extensions.object(name)

    def bad(self, key: str, expected: str) -> InputError:
        return InputError(f"{self.place(key)} is {_description(self._data.get(key))}; it must be {expected}")

    def _value(self, key: str, default: Any, expected: str) -> Any:
        value = self._data.get(key)
        if value is None:
            if default is REQUIRED:
                raise InputError(f"{self.place(key)} is missing; it must be {expected}")
            return default
        return value

    def _whole(self, value: Any, key: str, low: int, high: int) -> int:
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value < high:
            limit = f"from {low} to {high - 1}" if high > low else "absent: there is nothing to refer to"
            raise InputError(f"{self.place(key)} is {_description(value)}; it must be a whole number {limit}")
        return value

    def _number(self, value: Any, key: str) -> float:
        if not isinstance(value, (int, float)) or isinstance(value, bool) or abs(value) > 1e300:
            raise InputError(f"{self.place(key)} holds {_description(value)}; it must be a finite number")
        return float(value)


def parse(text: bytes, file: str) -> Fields:
    """The root object of a JSON document."""
    try:
        data = json.loads(text, parse_constant=_no_constant)
    except RecursionError:
        raise InputError(f"{file}: JSON is nested too deeply; export the file again") from None
    except ValueError as error:
        reason = " ".join(str(error).split())[:120]
        raise InputError(f"{file}: JSON cannot be read ({reason}); export the file again") from None
    return Fields(data, f"{file}:")


def _no_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not JSON")


def _name(data: object) -> str:
    name = data.get("name") if isinstance(data, dict) else None
    return f' "{name[:40]}"' if isinstance(name, str) and name.isprintable() and name else ""


def _description(value: object) -> str:
    if isinstance(value, (dict, list)):
        return "an object" if isinstance(value, dict) else f"a list of {len(value)}"
    if isinstance(value, float) and not math.isfinite(value):
        return "infinite"
    text = "a huge number" if isinstance(value, int) and abs(value) > 10**40 else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."
