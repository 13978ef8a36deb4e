"""An edit recompiles only the kernels that depend on it, and Python then calls the edited kernels."""

import shutil

import pytest

import sample_package as sample
from antumbra.kernels import simd
from antumbra.kernels.toolchain import kernel_digest

BEFORE = {
    "alone": 101, "by_call": 4, "by_constant": 6, "by_module": 6, "by_overload": 6, "by_field": 5,
    "by_guest": 8, "by_guest_inside": 9,
    "by_result": {"a": 1, "b": 2}, "by_intrinsic": 2, "by_operator": 6.0, "by_loop": 6,
}  # fmt: skip
TICKETS = "kernels/ticket_loops.py"
LANES, MEMORY, SCALARS, OPERATORS = (f"kernels/simd/{m}.py" for m in ("lanes", "load_store", "lanes", "vectors"))

GUESTS = {"by_guest": 8, "by_guest_inside": 9}  # they call an overload that has other definitions too

EDITS = {
    "own body": ("sample/top.py", "return x + 100", "return x + 200", {"alone": 201}),
    "two calls down": ("sample/parts.py", "return x + 1  # one", "return x + 2  # two", {"by_call": 6}),
    "inlined or not": ("sample/parts.py", "@inlined", "@kernel", {"by_call": 4}),
    "overload": ("sample/choices.py", "lambda x: x + add", "lambda x: x - add", {"by_overload": -4, **GUESTS}),
    "what an overload asks": ("sample/choices.py", "return 5", "return 6", {"by_overload": 7, **GUESTS}),
    "overload of another module": ("sample/guest.py", "x.n + 7", "x.n + 8", {"by_guest": 9, "by_guest_inside": 10}),
    "constant": ("sample/parts.py", "SCALE = 3", "SCALE = 4", {"by_constant": 8, "by_module": 8}),
    "constant's type": ("sample/parts.py", "SCALE = 3", "SCALE = 3.0", {"by_constant": 6.0, "by_module": 6.0}),
    "fields": (
        "sample/parts.py", "    a: int\n    b: int", "    b: int\n    a: int",
        {"by_field": -5, "by_result": {"b": 1, "a": 2}},
    ),
    "intrinsic": (SCALARS, '"llvm.ctpop.i64")', '"llvm.bswap.i64")', {"by_intrinsic": 3 << 56}),
    "what an intrinsic calls": (MEMORY, "elements must be", "all must be", {"by_intrinsic": 2, "by_operator": 6.0}),
    "operator": (
        OPERATORS, '_method("fadd", "add")', '_method("fsub", "sub")',
        {"by_intrinsic": 2, "by_operator": 0.0, "by_loop": 6},
    ),
    "loop": (TICKETS, "builder.add(item, _I64(1))", "builder.add(item, _I64(2))", {"by_loop": 2}),
    "what a decorator registers": (TICKETS, "value=args[0]", "value=args[-1]", {"by_loop": 6}),
    "comment": ("sample/parts.py", "# one", "# one more", {}),
    "docstring": ("sample/parts.py", '"""One more."""', '"""One more than before."""', {}),
    "comment of an intrinsic": (LANES, "# --- make ----", "# --- made ----", {}),
    "docstring of a module of intrinsics": (OPERATORS, "The vector types, the", "All vector types, the", {}),
    "line numbers": ("sample/parts.py", "SCALE = 3\n", "SCALE = 3\n\n\n", {}),
}  # fmt: skip


def test_names_that_one_statement_defines_are_told_apart():
    names = [name for name in simd.__all__ if name != "__all__"]
    digests = {kernel_digest.definition_digest(f.module, f.name) for f in (getattr(simd, name) for name in names)}
    assert len(digests) == len(names) > 50


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """(folder of the package, its cache) after all kernels have been called once."""
    folder = tmp_path_factory.mktemp("package")
    package = sample.write(folder)
    found, sources, numba = sample.run(package, folder / "cache")
    assert found == BEFORE and set(sources.values()) == {"compiled"} and numba
    return package, folder / "cache"


@pytest.fixture
def copied(compiled, tmp_path):
    """The same package and cache in another place."""
    package, cache = compiled
    shutil.copytree(package, tmp_path / "antumbra")
    shutil.copytree(cache, tmp_path / "cache")
    return tmp_path / "antumbra", tmp_path / "cache"


def test_another_place_shares_the_cache_and_does_not_import_numba(copied):
    found, sources, numba = sample.run(*copied)
    assert found == BEFORE and set(sources.values()) == {"cache"} and not numba


@pytest.mark.parametrize("what", EDITS)
def test_an_edit_compiles_what_depends_on_it(copied, what):
    file, old, new, changed = EDITS[what]
    sample.edit(copied[0], file, old, new)
    found, sources, _ = sample.run(*copied)
    assert found == BEFORE | changed
    assert {name for name, source in sources.items() if source == "compiled"} == set(changed)


def test_another_compiler_compiles_everything(copied):
    sample.edit(
        copied[0], "kernels/machine_code.py", "speed_level = 0 if cheap else 3", "speed_level = 0 if cheap else 2"
    )
    found, sources, _ = sample.run(*copied)
    assert found == BEFORE and set(sources.values()) == {"compiled"}


def test_a_value_whose_changes_would_go_unnoticed_is_refused(copied):
    sample.edit(copied[0], "sample/top.py", "return x + 100", "return x + len(THINGS)")
    sample.edit(copied[0], "sample/top.py", "@kernel\ndef alone", "THINGS = {1: 2}\n\n\n@kernel\ndef alone")
    with pytest.raises(AssertionError, match="kernels cannot name THINGS, a builtins:dict"):
        sample.run(*copied)
