"""Parquet files: types of columns that do not depend on the block, and records of parts that a changed byte unmasks."""

from types import SimpleNamespace

import numpy as np
import pytest

import antumbra as at
from antumbra.city.sensors.sensors import point_sensors
from antumbra.city.tables.parquet_files import part_columns, part_record, save_parquet, write_parquet

parquet = pytest.importorskip("pyarrow.parquet")


def table(names):
    """A table with a column of each kind."""
    n = len(names)
    values = {
        "name": np.array(names, object),
        "time": np.arange(n).astype("datetime64[m]"),
        "hours": np.linspace(0.0, 1.0, n),
        "count": np.arange(n, dtype=np.int32),
        "passes": np.arange(n) % 2 == 0,
    }
    columns = {name: at.Column(each, "h" if name == "hours" else "", f"about {name}") for name, each in values.items()}
    return at.Table(point_sensors(np.zeros((n, 3))), columns, {"job": "test"})


@pytest.mark.parametrize("first", [[], [""], [None, None]])
def test_a_column_of_texts_is_one_in_every_block(tmp_path, first):
    blocks = [table(first), table(["a", "b"])]
    save_parquet(SimpleNamespace(blocks=lambda: iter(blocks), about={}), tmp_path / "a.parquet")
    read = parquet.read_table(tmp_path / "a.parquet")
    assert read["name"].to_pylist() == [*first, "a", "b"] and str(read.schema.field("name").type) == "string"
    write_parquet(blocks[0], tmp_path / "b.parquet", {})
    assert parquet.read_schema(tmp_path / "b.parquet").equals(read.schema.remove_metadata())


def test_a_part_gives_its_record_and_its_columns_back(tmp_path):
    made = table(["a", "", "c"])
    write_parquet(made, tmp_path / "a.parquet", {"of": "x 3", "rows": 3})
    assert part_record(tmp_path / "a.parquet") == {"of": "x 3", "rows": 3}
    values, units = part_columns(tmp_path / "a.parquet", made.columns)
    for name, each, unit in zip(made.columns, values, units):
        assert (each.astype(made[name].dtype) == made[name]).all() and unit == made.columns[name][1:]


def test_any_changed_byte_of_the_pages_is_found(tmp_path):
    path = tmp_path / "a.parquet"
    write_parquet(table([f"name {k}" for k in range(200)]), path, {"of": "x"})
    whole = path.read_bytes()
    end = len(whole) - 8 - int.from_bytes(whole[-8:-4], "little")
    assert part_record(path) == {"of": "x"} and end > 1000
    for place in range(0, end, 97):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        assert part_record(path) is None, place
    for length in (0, 7, end, len(whole) - 1):
        path.write_bytes(whole[:length])
        assert part_record(path) is None, length


def test_files_that_are_no_parts_have_no_record(tmp_path):
    save_parquet(table(["a"]), tmp_path / "whole.parquet")
    (tmp_path / "text.parquet").write_text("no Parquet")
    assert not any(part_record(tmp_path / f"{name}.parquet") for name in ("whole", "text", "missing"))
