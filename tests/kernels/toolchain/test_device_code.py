"""Device kernels become PTX and SPIR-V, once, and everything that a device cannot do is refused."""

import numpy as np
import pytest

import device_kernels as sample
from antumbra.base.errors import InputError
from antumbra.kernels.device import i64_at, local_i32, thread_index
from antumbra.kernels.jit import Intrinsic, kernel
from antumbra.kernels.simd import bits, f32_at, get, i32_at, load4, put, stack_i32
from antumbra.kernels.toolchain import (
    device_code,
    device_emission,
    device_ir,
    kernel_cache,
    numba_frontend,
    ptx_target,
    spirv_target,
)
from antumbra.kernels.toolchain.rounding_checks import check_rounding

TABLE = np.arange(5, dtype=np.float32) ** 2

FORMS = pytest.mark.parametrize("form", device_code.FORMS)
SAMPLES = pytest.mark.parametrize("each", sample.SAMPLES, ids=lambda each: each.name)


@kernel
def returns(a):
    return get(f32_at(a), thread_index())


@kernel
def raises(a):
    if thread_index() > 5:
        raise ValueError("an index is too large")
    put(i64_at(a), 0, 1)


@kernel
def calls_the_c_library(a):
    put(f32_at(a), 0, np.sin(get(f32_at(a), 0)))


@kernel
def points_to_two_kinds(a):
    own = stack_i32(4)
    for k in range(4):
        put(own, k, k)
    there = i32_at(a)
    put(there, 0, get(there if get(there, 1) else own, get(there, 2)))


@kernel
def reads_a_table(a):
    put(f32_at(a), 0, TABLE[get(i32_at(a), 1)])


@kernel
def has_bits_of_masks(a):
    put(i64_at(a), 0, bits(load4(f32_at(a), 1) < np.float32(0)))


@kernel
def takes_remainders(a):
    put(f32_at(a), 0, get(f32_at(a), 0) % np.float32(3))


@kernel
def chooses_among_many(a):
    kind, result = get(i32_at(a), thread_index()), 7
    if kind == 0:
        result = 13
    elif kind == 1:
        result = 2
    elif kind == 2:
        result = 55
    elif kind == 3:
        result = 8
    elif kind == 4:
        result = 100
    put(i32_at(a), thread_index(), result)


@kernel
def points_to_memory_of_blocks(a):
    block = local_i32(16, 4)
    put(i32_at(a), 0, get(block, get(i32_at(a), 1)))


@kernel
def two_numbers(a, b):
    put(i64_at(a), thread_index(), b)


@SAMPLES
@FORMS
def test_code_has_an_entry_with_a_parameter_for_each_word(each, form):
    code = each.code(form)
    assert code.form == form and code.digest in code.entry and code.entry.encode() in code.code
    if form == "ptx":
        text = code.code.decode()
        assert text.count(".visible .entry") == 1 and text.count(".param .u64") == code.words
    else:
        assert code.code[:4] == b"\x03\x02\x23\x07"  # SPIR-V's magic number


def test_pointers_made_from_arguments_are_global():
    text = sample.LINKS.code("ptx").code.decode()
    assert "ld.global.v4" in text and "st.local" in text and "atom.global.add.u64" in text
    assert not [line for line in text.splitlines() if line.strip().startswith(("ld.b", "st.b", "ld.v", "cvta"))]


def test_memory_of_a_block_is_shared():
    assert ".shared" in sample.REVERSED.code("ptx").code.decode()


@pytest.mark.parametrize(
    "function, message",
    [
        (returns, "returns a value: a device kernel writes its results to memory"),
        (raises, "may raise: a device kernel cannot"),
        (calls_the_c_library, "needs llvm.sin.f32: a device has no such function"),
        (points_to_two_kinds, "may point to memory of two kinds"),
        (reads_a_table, "needs tables of constants"),
        (has_bits_of_masks, "needs the bits of a mask"),
        (takes_remainders, "needs floorf: a device has no such function"),
    ],
)
def test_what_no_device_can_do_is_refused(function, message):
    with pytest.raises(TypeError, match=message):
        device_code.device_code(function, (0,), "ptx")


def test_a_block_of_local_memory_reaches_to_the_end_of_its_last_part():
    assert ".b8 antumbra_local[32]" in device_code.device_code(points_to_memory_of_blocks, (0,), "ptx").code.decode()


def test_a_choice_among_many_values_needs_no_table():
    text = device_code.device_code(chooses_among_many, (0,), "ptx").code.decode()
    assert ".global ." not in text and "brx" not in text


def assembly(calls):
    """A kernel that calls some of LLVM's functions: (name, type of the result, types of the arguments)."""
    lines, declarations = [], []
    for at, (name, result, arguments) in enumerate(calls):
        names = ["false" if kind == "i1" else f"%x{at}.{k}" for k, kind in enumerate(arguments)]
        lines += [f"{x} = load {kind}, ptr addrspace(1) %a" for x, kind in zip(names, arguments) if x != "false"]
        values = ", ".join(f"{kind} {x}" for x, kind in zip(names, arguments))
        lines.append(f"%r{at} = call {result} @{name}({values})")
        part = f"extractvalue {result} %r{at}, 0" if result[0] == "{" else f"freeze {result} %r{at}"
        lines += [f"%s{at} = {part}", f"store {result.strip('{').split(',')[0]} %s{at}, ptr addrspace(1) %a"]
        declarations.append(f"declare {result} @{name}({', '.join(arguments)})")
    body = "\n".join(["%a = inttoptr i64 %w0 to ptr addrspace(1)", *lines, "ret void"])
    return "\n".join([*declarations, "define void @entry(i64 %w0) {", body, "}"])


def calls_of(name):
    """Calls of one of LLVM's functions for all types: (name, type of the result, types of the arguments)."""
    if name in device_ir.EXACT_OF_INTEGERS:
        for kind in "i32", "i64":
            flag, one = name in ("abs", "ctlz", "cttz"), name == "ctpop"
            arguments = [kind, "i1"] if flag else [kind] if one else [kind] * 2
            yield f"llvm.{name}.{kind}", f"{{{kind}, i1}}" if "overflow" in name else kind, arguments
        return
    n = 3 if name[:2] == "fm" else 2 if name[:3] in ("min", "max", "cop") else 1
    for kind, form in ("f32", "float"), ("f64", "double"):
        if name.startswith("fpto"):
            yield from ((f"llvm.{name}.i{width}.{kind}", f"i{width}", [form]) for width in (32, 64))
        else:
            yield f"llvm.{name}.{kind}", form, [form] * n


@pytest.mark.parametrize("names", [device_ir.EXACT_OF_FLOATS, device_ir.EXACT_OF_INTEGERS], ids=["floats", "integers"])
def test_both_targets_have_exact_operations_for_the_intrinsics_that_kernels_may_use(names):
    text = assembly([call for name in names for call in calls_of(name)])
    modules = ptx_target.ptx_module(text, "entry"), spirv_target.spirv_module(text, "entry")
    for form, code in zip(device_code.FORMS, device_emission.emit_modules(modules)):
        check_rounding(device_code.DeviceCode(form, "entry", 1, code, ""))


def test_what_llvm_cannot_emit_is_an_error():
    module = spirv_target.spirv_module(assembly([("llvm.sin.f128", "fp128", ["fp128"])]), "entry")
    with pytest.raises(device_emission.EmissionError):
        device_emission.emit_modules([module])


def test_code_does_not_depend_on_what_was_compiled_before():
    """LLVM keeps numbers of labels from one SPIR-V module to the next, and Numba counts the functions that it names."""
    first = {each: device_code._compiled(each.kernel, each.key, "entry") for each in (sample.LINKS, sample.ODDS)}
    numba_frontend.part_of(sample.LINKS.kernel).lowered.clear()
    again = {each: device_code._compiled(each.kernel, each.key, "entry") for each in (sample.ODDS, sample.LINKS)}
    assert again == first


def test_arguments_of_other_kinds_are_other_code():
    integer, real = (device_code.device_code(two_numbers, (0, x), "ptx") for x in (0, 0.0))
    assert integer.words == real.words == 2 and integer.digest != real.digest


@pytest.fixture
def empty_cache(tmp_path, monkeypatch):
    """A cache of this test's own, and no code in this process."""
    monkeypatch.setattr(device_code, "cache_folder", lambda: tmp_path)
    device_code._code.cache_clear()
    yield tmp_path
    device_code._code.cache_clear()


def test_code_is_compiled_once_and_then_found_on_disk(empty_cache, monkeypatch):
    first = {form: device_code.device_code(two_numbers, (0, 0), form) for form in device_code.FORMS}
    files = sorted(
        file.relative_to(empty_cache / "kernels" / kernel_cache.toolchain()) for file in empty_cache.rglob("*.kernel")
    )
    assert [file.parts[0] for file in files] == ["ptx", "spirv"]
    monkeypatch.setattr(device_ir, "device_ir", lambda *arguments: pytest.fail("it is compiled again"))
    device_code._code.cache_clear()
    assert {form: device_code.device_code(two_numbers, (0, 0), form) for form in device_code.FORMS} == first


def test_code_is_the_same_when_it_is_compiled_again(empty_cache):
    first = sample.LINKS.code("spirv")
    for file in empty_cache.rglob("*.kernel"):
        file.unlink()
    device_code._code.cache_clear()
    assert sample.LINKS.code("spirv") == first


def test_a_cache_that_cannot_be_written_is_no_error(empty_cache):
    (empty_cache / "kernels").write_text("a file")
    assert device_code.device_code(two_numbers, (0, 0), "ptx").words == 2


def test_a_kernel_that_another_process_has_compiled_meanwhile_is_not_compiled_again(empty_cache, monkeypatch):
    code, lock = device_code.load_or_compile_forms(two_numbers, "i i"), kernel_cache.KernelFolder.lock
    stored = {file: file.read_bytes() for file in empty_cache.rglob("*.kernel")}
    for file in stored:
        file.unlink()

    def lock_after_the_other_process(folder, digest):
        for file, data in stored.items():
            file.write_bytes(data)
        return lock(folder, digest)

    monkeypatch.setattr(kernel_cache.KernelFolder, "lock", lock_after_the_other_process)
    monkeypatch.setattr(device_code, "_compiled", lambda *arguments: pytest.fail("it is compiled again"))
    assert len(stored) == 2 and device_code.load_or_compile_forms(two_numbers, "i i") == code


def test_a_kernel_that_is_not_installed_needs_a_compiler(empty_cache, monkeypatch):
    monkeypatch.setattr(device_code, "has_compiler", lambda: False)
    with pytest.raises(
        InputError, match=r"two_numbers is not among the device kernels .* pip install 'antumbra\[jit\]'"
    ):
        device_code.device_code(two_numbers, (0, 0), "ptx")


def test_the_names_of_intrinsics_have_implementations():
    from antumbra.kernels import device
    from antumbra.kernels.device import operations

    assert sorted(device._NAMES.split()) == device.__all__
    assert all(isinstance(getattr(device, name), Intrinsic) and hasattr(operations, name) for name in device.__all__)
