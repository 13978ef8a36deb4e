"""The rows of tables of points in .csv, .parquet, .npz and .npy files: all at once, or any of them by block.

A table is surveyed once from its start to its end: rows are counted and checked, and the types of its columns become
known, which in a CSV file depend on all rows. Then any rows can be read, from the last mark before them. A mark is a
place in the file at which reading can begin: a row group of Parquet, or a line of CSV.
"""

import csv
import warnings
import zipfile
from abc import ABC, abstractmethod
from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...base.files import checked_file
from ...base.memory import check_reading
from ...base.wording import counted
from ...formats.array_files import mapped_array, npz_arrays
from ..gis.csv_rows import check_fields, check_header
from ..gis.vector_files import BATCH, check_columns, check_groups, open_parquet
from .point_attributes import Attributes, kind_of_texts, left_out_note, of_kind

CSV_ROWS = 1 << 14
"""Lines of a CSV file that are read at a time."""

_COPIES = 2  # of an array: as stored, and as float64
_ABOUT = "about"  # metadata in .npz files of results
_PLAIN = "fiubM"  # kinds of attributes besides texts

Visit = Callable[[int, NDArray[np.float64]], None]
"""Function of a row and the (n, k) numbers from there on, which a survey calls for all rows in order."""


class Rows(NamedTuple):
    """Some rows of a table."""

    numbers: NDArray[np.float64]  # (n, k) of the columns that are read as numbers
    attributes: Attributes  # all others


class Batch(NamedTuple):
    """Rows that are read together."""

    mark: Any  # where reading can begin, at these rows or before them
    numbers: NDArray[np.float64]  # (n, k)
    others: dict[str, Any]  # other columns as the file has them


@contextmanager
def reader_errors(path: Path) -> Iterator[None]:
    """Turn errors of readers into an InputError that names the file."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # csv, zipfile and pyarrow raise many kinds of errors for damaged files
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(f"{path.name}: cannot be read ({reason}); write it again") from error


class TableRows(ABC):
    """A table whose columns `used` are numbers, and all others attributes."""

    names: list[str]  # of its columns, in lower case

    def __init__(self, path: Path):
        self.path, self.used = path, tuple[str, ...]()
        self.n = 0  # rows, once surveyed
        self._kinds: dict[str, np.dtype[Any] | None] | None = None  # of attributes; None: no plain values
        self._marks, self._firsts = list[Any](), list[int]()  # and the first rows that can be read from there
        self._reading: Iterator[Batch] | None = None
        self._held: Rows | None = None  # the last batch, which begins at `_first`
        self._first = self._next = 0
        self._stamp = _stamp(path)

    def select(self, used: Collection[str]) -> None:
        """Choose the columns that are read as numbers, by their lower-case names. InputError if one holds others."""
        self.used = tuple(name for name in used if name in self.names)
        with reader_errors(self.path):
            self._sort_columns()

    def survey(self, visit: Visit = lambda first, numbers: None) -> None:
        """Read the table once. A note names columns that are no plain values, and are left out.

        Raises
        ------
        InputError
            If the file cannot be read, or a column in use has a value that is no number.
        """
        with reader_errors(self.path):
            self._check_memory(whole=False)
            for batch in self._surveyed():
                visit(self.n - len(batch.numbers), batch.numbers)

    def whole(self) -> Rows:
        """All rows, which are surveyed at the same time."""
        with reader_errors(self.path):
            self._check_memory(whole=True)
            batches = list(self._surveyed())
            attributes = [self._attributes(batch) for batch in batches]
        names = attributes[0]
        joined = {name: np.concatenate([each.pop(name) for each in attributes]) for name in list(names)}
        return Rows(np.concatenate([batch.numbers for batch in batches]), joined)

    def rows(self, first: int, last: int) -> Rows:
        """The rows from `first` to `last`, exclusive, of a surveyed table.

        Raises
        ------
        InputError
            If the file has been changed.
        """
        pieces = [self._nothing()] if first >= last else []
        while first < last:
            with reader_errors(self.path):
                held, start, end = self._batch_with(first)
            some = slice(first - start, min(last, end) - start)
            pieces.append(Rows(held.numbers[some], {name: v[some] for name, v in held.attributes.items()}))
            first = min(last, end)
        if len(pieces) == 1:
            return pieces[0]
        joined = {name: np.concatenate([each.attributes[name] for each in pieces]) for name in pieces[0].attributes}
        return Rows(np.concatenate([each.numbers for each in pieces]), joined)

    def _nothing(self) -> Rows:
        kinds = self._plain_kinds().items()
        return Rows(np.empty((0, len(self.used))), {name: np.empty(0, kind) for name, kind in kinds})

    def _surveyed(self) -> Iterator[Batch]:
        """Yield all batches, at least one, and take note of their number, types and marks."""
        self.n, self._kinds = 0, None
        self._marks, self._firsts = [], []
        for batch in self._batches(None):
            if not self._marks or batch.mark != self._marks[-1]:
                self._marks.append(batch.mark)
                self._firsts.append(self.n)
            if self._kinds is None or len(batch.numbers):
                kinds = self._kinds_in(batch)
                if self._kinds is not None and self.n:  # columns that are lacking in any batch are left out
                    known = self._kinds
                    kinds = {name: _joined(kind, known[name]) for name, kind in kinds.items() if name in known}
                self._kinds = kinds
            self.n += len(batch.numbers)
            yield batch
        assert self._kinds is not None
        if left_out := self._left_out() + [name for name, kind in self._kinds.items() if kind is None]:
            places = {name: k for k, name in enumerate(self.names)}
            left_out.sort(key=lambda name: places[name.lower()])
            warnings.warn(left_out_note(self.path.name, left_out), UserWarning, stacklevel=4)

    def _plain_kinds(self) -> dict[str, np.dtype[Any]]:
        """The types of the attributes that are not left out."""
        return {name: kind for name, kind in (self._kinds or {}).items() if kind is not None}

    def _batch_with(self, row: int) -> tuple[Rows, int, int]:
        """The batch with a row, its first row, and the one after its last. Reading goes on, or begins at a mark."""
        mark = bisect_right(self._firsts, row) - 1
        if self._reading is None or row < self._first or self._next < self._firsts[mark]:
            if _stamp(self.path) != self._stamp:
                raise InputError(f"{self.path.name}: was changed while it was read; run the command again")
            self._reading, self._next = self._batches(self._marks[mark]), self._firsts[mark]
        while row >= self._next:
            if (batch := next(self._reading, None)) is None:
                raise InputError(f"{self.path.name}: has lost rows while it was read; run the command again")
            self._held = Rows(batch.numbers, self._attributes(batch))
            self._first, self._next = self._next, self._next + len(batch.numbers)
        assert self._held is not None
        return self._held, self._first, self._next

    def _sort_columns(self) -> None:  # noqa: B027 - arrays have nothing to sort
        """Find those in use and the attributes."""

    def _left_out(self) -> list[str]:
        """Columns that are known not to be attributes."""
        return []

    def _check_memory(self, whole: bool) -> None:  # noqa: B027 - some formats do not expand
        """Raise an InputError if reading all rows, or some, takes too much memory."""

    @abstractmethod
    def _batches(self, mark: Any) -> Iterator[Batch]:
        """Yield the rows from a mark on; None: all, in one batch at least."""

    @abstractmethod
    def _kinds_in(self, batch: Batch) -> dict[str, np.dtype[Any] | None]:
        """The types that a batch alone would give to its attributes."""

    @abstractmethod
    def _attributes(self, batch: Batch) -> Attributes:
        """The attributes in a batch, in the types of the whole table."""


def _stamp(path: Path) -> tuple[int, int]:
    """What changes when a file is written."""
    status = checked_file(path, path.name).stat()
    return status.st_size, status.st_mtime_ns


def _joined(a: np.dtype[Any] | None, b: np.dtype[Any] | None) -> np.dtype[Any] | None:
    """The type of values of two types."""
    return None if a is None or b is None else np.result_type(a, b)


def table_rows(path: Path) -> TableRows:
    """The table in a .csv, .parquet, .npz or .npy file. Raises InputError if it cannot be read."""
    checked_file(path, path.name)
    with reader_errors(path):
        return _READERS[path.suffix.lower()](path)


def read_table(path: Path, used: Collection[str]) -> tuple[dict[str, NDArray[np.float64]], Attributes]:
    """The columns of a .csv, .parquet or .npz file.

    used : lower-case names of those that are numbers; names that the file lacks are lacking in the result, too

    Raises
    ------
    InputError
        If the file cannot be read, or a column in use holds anything but numbers.
    """
    table = table_rows(path)
    table.select(used)
    rows = table.whole()
    return dict(zip(table.used, np.ascontiguousarray(rows.numbers.T))), rows.attributes


# --- CSV --------------------------------------------------------------------------------------------------------------


class _CsvRows(TableRows):
    """Marks are the position in the file, as text files tell it, and the number of a line."""

    def __init__(self, path: Path):
        super().__init__(path)
        with self._open() as file:
            self._header = [name.strip() for name in next(csv.reader(file), [])]
        self.names = [name.lower() for name in self._header]

    def _open(self) -> Any:
        return open(self.path, newline="", encoding="utf-8-sig")

    def _sort_columns(self) -> None:
        check_header([name for name in self.names if name in self.used], self.path.name)
        self._columns = [self.names.index(name) for name in self.used]
        others = [k for k, name in enumerate(self.names) if name and name not in self.used]
        counts = Counter(self._header[k] for k in others)
        self._twice = [name for name, count in counts.items() if count > 1]
        self._others = {self._header[k]: k for k in others if counts[self._header[k]] == 1}

    def _left_out(self) -> list[str]:
        return self._twice

    def _batches(self, mark: Any) -> Iterator[Batch]:
        with self._open() as file:
            rows, line = csv.reader(iter(file.readline, "")), 2  # iterating over a file forbids `tell`
            if mark is None:
                next(rows, None)
            else:
                file.seek(mark[0])
                line = mark[1]
            start = line
            while True:
                here = file.tell(), line
                some = list(islice(rows, CSV_ROWS))
                if some or line == start:
                    yield self._batch(here, some)
                line += len(some)
                if len(some) < CSV_ROWS:
                    return

    def _batch(self, mark: tuple[int, int], lines: list[list[str]]) -> Batch:
        rows = [row for row in lines if row]
        if set(map(len, rows)) <= {len(self._header)}:
            fields: Any = list(zip(*rows)) or [()] * len(self._header)
            with suppress(ValueError):
                columns = [np.fromiter(map(float, fields[k]), np.float64, len(rows)) for k in self._columns]
                numbers = np.stack(columns, 1) if columns else np.empty((len(rows), 0))
                return Batch(mark, numbers, {name: fields[k] for name, k in self._others.items()})
        numbers = np.array([self._numbers(row, line) for line, row in enumerate(lines, mark[1]) if row], np.float64)
        others = {name: [row[k] if k < len(row) else "" for row in rows] for name, k in self._others.items()}
        return Batch(mark, numbers.reshape(len(rows), len(self._columns)), others)

    def _numbers(self, row: list[str], line: int) -> list[float]:
        """The numbers in a line. InputError if one is missing."""
        check_fields(len(row), len(self._header), line, self.path.name)
        try:
            return [float(row[k]) for k in self._columns]
        except (ValueError, IndexError):
            text = ",".join(row)[:60]
            raise InputError(f"{self.path.name}, line {line}: {text!r} lacks a number of a point") from None

    def _kinds_in(self, batch: Batch) -> dict[str, np.dtype[Any] | None]:
        text = np.dtype(object)
        known = {name for name, kind in self._plain_kinds().items() if kind == text}
        return {
            name: text if name in known else kind_of_texts(_stripped(texts)) for name, texts in batch.others.items()
        }

    def _attributes(self, batch: Batch) -> Attributes:
        return {name: of_kind(_stripped(batch.others[name]), kind) for name, kind in self._plain_kinds().items()}


def _stripped(texts: Sequence[str]) -> list[str]:
    return list(map(str.strip, texts))


# --- Parquet ----------------------------------------------------------------------------------------------------------


class _ParquetRows(TableRows):
    """Marks are the numbers of row groups."""

    def __init__(self, path: Path):
        super().__init__(path)
        with open_parquet(path, whole=False) as file:
            self._schema = file.schema_arrow
        self.names = [name.lower() for name in self._schema.names]

    def _sort_columns(self) -> None:
        import pyarrow

        self._columns = {name.lower(): name for name in self._schema.names if name.lower() in self.used}
        for name in self._columns.values():
            _check_kind(np.dtype(self._type(name).to_pandas_dtype()), name, self.path)
        geometries = b"geo" in (self._schema.metadata or {})  # points have a geometry of their own in the results
        names = [name for name in self._schema.names if name.lower() not in self.used]
        names = [name for name in names if not (geometries and pyarrow.types.is_binary(self._type(name)))]
        kinds = {name: _kind_of(self._type(name)) for name in names}
        self._texts = {name for name, kind in kinds.items() if kind is str}
        self._others = [name for name, kind in kinds.items() if kind is str or _is_plain(kind)]
        fit = set(self._others)
        self._unfit = [name for name in names if name not in fit]

    def _type(self, name: str) -> Any:
        return self._schema.field(name).type

    def _left_out(self) -> list[str]:
        return self._unfit

    def _check_memory(self, whole: bool) -> None:
        names = [*self._columns.values(), *self._others]
        with open_parquet(self.path, sorted(self._texts), whole) as file:
            if whole:
                check_columns(file, names, self.path)
            else:
                check_groups(file, len(names), self.path)

    def _batches(self, mark: Any) -> Iterator[Batch]:
        import pyarrow

        names, none = [*self._columns.values(), *self._others], True
        with open_parquet(self.path, sorted(self._texts), whole=False) as file:
            for group in range(mark or 0, file.metadata.num_row_groups):
                for batch in file.iter_batches(BATCH, row_groups=[group], columns=names):
                    none = False
                    yield self._batch(group, pyarrow.Table.from_batches([batch]))
            if none:
                yield self._batch(0, file.schema_arrow.empty_table())

    def _batch(self, group: int, table: Any) -> Batch:
        numbers = np.empty((len(table), len(self.used)))
        for k, name in enumerate(self.used):
            numbers[:, k] = _array_of(table[self._columns[name]].combine_chunks())
        return Batch(group, numbers, {name: table[name].combine_chunks() for name in self._others})

    def _kinds_in(self, batch: Batch) -> dict[str, np.dtype[Any] | None]:
        kinds = dict[str, np.dtype[Any] | None]()
        for name, values in batch.others.items():
            kind = np.dtype(object) if name in self._texts else _array_of(values).dtype
            kinds[name] = kind if name in self._texts or _is_plain(kind) else None
        return kinds

    def _attributes(self, batch: Batch) -> Attributes:
        columns = Attributes()
        for name, kind in self._plain_kinds().items():
            values = batch.others[name]
            columns[name] = _texts_of(values) if name in self._texts else _wide(_array_of(values).astype(kind))
        return columns


def _array_of(values: Any) -> NDArray[Any]:
    return np.asarray(values.to_numpy(zero_copy_only=False))


def _kind_of(kind: Any) -> Any:
    """The NumPy type of an Arrow type; str for texts, None for other types that NumPy lacks."""
    import pyarrow

    if str(kind.value_type if pyarrow.types.is_dictionary(kind) else kind) in ("string", "large_string"):
        return str
    try:
        return kind.to_pandas_dtype()
    except NotImplementedError:
        return None


def _is_plain(kind: Any) -> bool:
    """Whether values of a type are numbers or times, unlike bool with missing values."""
    return isinstance(kind, type | np.dtype) and np.dtype(kind).kind in _PLAIN


def _texts_of(values: Any) -> NDArray[Any]:
    """(n,) of texts in a dictionary of Arrow; missing ones are empty."""
    known = np.array([*(text or "" for text in values.dictionary.to_pylist()), ""], object)
    return np.asarray(known[values.indices.fill_null(-1).to_numpy(zero_copy_only=False)])


def _wide(values: NDArray[Any]) -> NDArray[Any]:
    """Numbers in the types that all formats of tables have."""
    wide = {"i": np.int64, "u": np.int64, "f": np.float64}.get(values.dtype.kind)
    return values if wide is None else values.astype(np.float64 if values.dtype == np.uint64 else wide)


# --- Arrays of NumPy --------------------------------------------------------------------------------------------------


class _NpzRows(TableRows):
    """The arrays of an archive, which can only be read whole."""

    def __init__(self, path: Path):
        super().__init__(path)
        with zipfile.ZipFile(path) as archive:
            self.names = list(dict.fromkeys(name.removesuffix(".npy").lower() for name in archive.namelist()))
        self._unfit = list[str]()

    def _left_out(self) -> list[str]:
        return self._unfit

    def _batches(self, mark: Any) -> Iterator[Batch]:
        columns = {name: _numbers(v, name, self.path) for name, v in npz_arrays(self.path, self.used).items()}
        counts = {name: len(values) for name, values in columns.items()}
        n = next(iter(counts.values()), 0)
        if odd := next((name for name, count in counts.items() if count != n), None):
            raise InputError(
                f"{self.path.name}: has {counted(counts[odd], 'value')} of {odd!r}, and {n} of {self.used[0]!r}"
            )
        others, self._unfit = Attributes(), []
        for name in self.names:
            if name in self.used or name == _ABOUT:
                continue
            try:
                others |= npz_arrays(self.path, [name])
            except InputError:  # no numbers
                self._unfit.append(name)
        numbers = np.stack([columns[name] for name in self.used], 1) if self.used else np.empty((0, 0))
        yield Batch(0, numbers, others)

    def _kinds_in(self, batch: Batch) -> dict[str, np.dtype[Any] | None]:
        n = len(batch.numbers)
        return {name: values.dtype if values.shape == (n,) else None for name, values in batch.others.items()}

    def _attributes(self, batch: Batch) -> Attributes:
        return {name: _wide(batch.others[name]) for name in self._plain_kinds()}


class _NpyRows(TableRows):
    """The rows of an array, which is mapped: x, y and z, and perhaps nx, ny and nz."""

    def __init__(self, path: Path):
        super().__init__(path)
        self._array = array = mapped_array(path, path.name)
        if array.ndim != 2 or array.shape[1] not in (3, 6) or array.dtype.kind not in "fiu":
            raise InputError(
                f"{path.name}: the array is {array.dtype} {array.shape}; points are (n, 3), points and normals (n, 6)"
            )
        self.names = ["x", "y", "z", "nx", "ny", "nz"][: array.shape[1]]

    def _batches(self, mark: Any) -> Iterator[Batch]:
        for first in range(mark or 0, max(len(self._array), 1), BATCH):
            yield Batch(first, np.array(self._array[first : first + BATCH], np.float64), {})

    def _check_memory(self, whole: bool) -> None:
        if whole:
            check_reading(_COPIES * self._array.nbytes, self.path.name)

    def _kinds_in(self, batch: Batch) -> dict[str, np.dtype[Any] | None]:
        return {}

    def _attributes(self, batch: Batch) -> Attributes:
        return {}


_READERS: dict[str, Callable[[Path], TableRows]] = {
    ".csv": _CsvRows,
    ".parquet": _ParquetRows,
    ".npz": _NpzRows,
    ".npy": _NpyRows,
}


def _numbers(values: np.ndarray, name: str, path: Path) -> np.ndarray:
    _check_kind(values.dtype, name, path)
    if values.ndim != 1:
        raise InputError(f"{path.name}: column {name!r} must hold numbers, not arrays {values.shape}")
    return values.astype(np.float64)


def _check_kind(kind: np.dtype[Any], name: str, path: Path) -> None:
    if kind.kind not in "fiu":
        raise InputError(f"{path.name}: column {name!r} must hold numbers, not {kind}")
