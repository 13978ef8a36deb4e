"""Each PTX instruction does what NVIDIA's manual says, and an instruction that is not known is an error."""

import numpy as np
import pytest

from antumbra.devices.device import DeviceError
from antumbra.devices.host.host_device import HostDevice
from ptx_snippets import applied, run_snippet, snippet

F32, F64, I32, I64, U32 = np.float32, np.float64, np.int32, np.int64, np.uint32
NAN, INF = np.nan, np.inf
TINY = 2.0**-149  # the least subnormal float32
BITS = {np.dtype(F32): I32, np.dtype(F64): I64}

CASES = [
    ("add.rn.f32", F32, F32, [[1.0, 2.0**-24], [1.0, 3 * 2.0**-25], [TINY, TINY]], [1.0, 1.0 + 2.0**-23, 2 * TINY]),
    ("sub.rn.f32", F32, F32, [[1.0, 2.0**-25], [INF, 1.0]], [1.0, INF]),
    ("mul.rn.f32", F32, F32, [[1e-30, 1e-15], [3.0, 1.0 / 3.0]], [TINY, 1.0]),
    ("div.rn.f32", F32, F32, [[1.0, 3.0], [1.0, 0.0]], [F32(1.0) / F32(3.0), INF]),
    ("fma.rn.f32", F32, F32, [[1.0 + 2.0**-23, 1.0 - 2.0**-23, -1.0]], [-(2.0**-46)]),
    ("fma.rn.f64", F64, F64, [[1.0 + 2.0**-52, 1.0 - 2.0**-52, -1.0]], [-(2.0**-104)]),
    ("rcp.rn.f32", F32, F32, [[3.0]], [F32(1.0) / F32(3.0)]),
    ("sqrt.rn.f64", F64, F64, [[2.0], [-0.0]], [np.sqrt(2.0), -0.0]),
    ("min.f32", F32, F32, [[NAN, 1.0], [1.0, NAN], [0.0, -0.0], [-0.0, 0.0]], [1.0, 1.0, -0.0, -0.0]),
    ("max.f32", F32, F32, [[NAN, 1.0], [0.0, -0.0], [-0.0, 0.0]], [1.0, 0.0, 0.0]),
    ("neg.f32", F32, F32, [[0.0], [2.0]], [-0.0, -2.0]),
    ("abs.f64", F64, F64, [[-0.0], [-INF]], [0.0, INF]),
    ("copysign.f32", F32, F32, [[-1.0, 2.0], [0.0, -3.0]], [-2.0, 3.0]),
    ("cvt.f64.f32", F32, F64, [[F32(0.1)]], [float(F32(0.1))]),
    ("cvt.rn.f32.f64", F64, F32, [[0.1], [1e-46]], [F32(0.1), 0.0]),
    ("cvt.rn.f32.s32", I32, F32, [[16777217], [-3]], [16777216.0, -3.0]),
    ("cvt.rzi.s32.f32", F32, I32, [[-1.9], [1e20], [NAN]], [-1, 2147483647, 0]),
    ("cvt.rmi.f32.f32", F32, F32, [[-1.5], [2.7]], [-2.0, 2.0]),
    ("cvt.rni.f32.f32", F32, F32, [[2.5], [3.5]], [2.0, 4.0]),
    ("cvt.s64.s32", I32, I64, [[-1]], [-1]),
    ("cvt.u64.u32", I32, I64, [[-1]], [2**32 - 1]),
    ("cvt.u32.u64", I64, I32, [[2**32 + 7]], [7]),
    ("cvt.s64.s8", I64, I64, [[255], [127]], [-1, 127]),
    ("add.s32", I32, I32, [[2**31 - 1, 1]], [-(2**31)]),
    ("sub.s64", I64, I64, [[1, 2]], [-1]),
    ("mul.lo.s32", I32, I32, [[65537, 65537]], [131073]),
    ("mul.hi.u32", I32, I32, [[-1, -1]], [-2]),
    ("mul.hi.s32", I32, I32, [[-1, 5]], [-1]),
    ("mul.wide.s32", I32, I64, [[-2, 3]], [-6]),
    ("mul.wide.u32", I32, I64, [[-1, 2]], [2**33 - 2]),
    ("mad.lo.s32", I32, I32, [[3, 4, 5]], [17]),
    ("div.s32", I32, I32, [[-7, 2]], [-3]),
    ("div.u32", I32, I32, [[-1, 2]], [2**31 - 1]),
    ("rem.s32", I32, I32, [[-7, 2]], [-1]),
    ("min.s32", I32, I32, [[-1, 1]], [-1]),
    ("min.u32", I32, I32, [[-1, 1]], [1]),
    ("max.s64", I64, I64, [[-1, 1]], [1]),
    ("abs.s32", I32, I32, [[-5]], [5]),
    ("neg.s32", I32, I32, [[5]], [-5]),
    ("not.b32", I32, I32, [[5]], [-6]),
    ("and.b32", I32, I32, [[6, 3]], [2]),
    ("or.b64", I64, I64, [[6, 3]], [7]),
    ("xor.b32", I32, I32, [[6, 3]], [5]),
    ("shl.b32", I32, I32, [[1, 31], [1, 32], [1, -1]], [-(2**31), 0, 0]),
    ("shr.u32", I32, I32, [[-1, 31], [-1, 32]], [1, 0]),
    ("shr.s32", I32, I32, [[-8, 1], [-8, 99]], [-4, -1]),
    ("shf.l.wrap.b32", I32, I32, [[-(2**31), 1, 1], [5, 7, 32]], [3, 7]),
    ("shf.r.wrap.b32", I32, I32, [[4, 1, 1]], [-(2**31) + 2]),
    ("bfe.u32 4 8", I32, I32, [[-1], [0x12345]], [255, 0x34]),
    ("bfe.s64 1 2", I64, I64, [[-1], [2]], [-1, 1]),
    ("popc.b32", I32, I32, [[-1], [5]], [32, 2]),
    ("popc.b64", I64, I32, [[-1]], [64]),
    ("clz.b32", I32, I32, [[0], [1]], [32, 31]),
    ("brev.b32", I32, I32, [[1]], [-(2**31)]),
]  # fmt: skip


@pytest.fixture(scope="module")
def device():
    return HostDevice()


@pytest.mark.parametrize("operation, kind, result, values, expected", CASES, ids=[case[0] for case in CASES])
def test_an_instruction_gives_the_exact_result(device, operation, kind, result, values, expected):
    with np.errstate(under="ignore"):
        expected = np.array(expected, result)
    bits = BITS.get(np.dtype(result), result)
    operation, *constants = operation.split()
    got = applied(device, operation, kind, result, values, constants)
    assert got.view(bits).tolist() == expected.view(bits).tolist()


@pytest.mark.parametrize(
    "comparison, expected",
    [("eq", "001"), ("ne", "110"), ("lt", "100"), ("geu", "0111"), ("ltu", "1001"), ("num", "1110"), ("nan", "0001")],
)
def test_comparisons_of_floats_with_nan(device, comparison, expected):
    pairs = np.array([[1, 2], [2, 1], [2, 2], [NAN, 1]], F32)
    code = f"""
    ld.global.v2.b32 {{%r1, %r2}}, [%rd1];
    setp.{comparison}.f32 %p1, %r1, %r2;
    selp.b64 %rd4, 1, 0, %p1;
    st.global.b64 [%rd2], %rd4;"""
    got = run_snippet(device, code, pairs.view(I64)[:, 0])
    assert "".join(map(str, got[: len(expected)])) == expected.ljust(3, "0")


@pytest.mark.parametrize("comparison, expected", [("lt.s32", 1), ("lt.u32", 0), ("hi.u32", 1), ("ne.b32", 1)])
def test_comparisons_of_integers_by_sign(device, comparison, expected):
    code = f"""
    mov.b32 %r1, -1;
    setp.{comparison} %p1, %r1, 1;
    selp.b64 %rd4, 1, 0, %p1;
    st.global.b64 [%rd2], %rd4;"""
    assert run_snippet(device, code, [0]).tolist() == [expected]


def test_predicates_and_branches_choose_what_is_executed(device):
    code = """
    ld.global.b64 %rd4, [%rd1];
    setp.gt.s64 %p1, %rd4, 10;
    @%p1 bra $large;
    mov.b64 %rd5, 1;
    @!%p1 add.s64 %rd5, %rd5, 1;
    @%p1 add.s64 %rd5, %rd5, 100;
    bra.uni $done;
    $large:
    mov.b64 %rd5, 7;
    $done:
    st.global.b64 [%rd2], %rd5;"""
    assert run_snippet(device, code, [3, 11]).tolist() == [2, 7]


def test_halves_of_words_are_packed_and_unpacked(device):
    code = """
    ld.global.b64 %rd4, [%rd1];
    mov.b64 {%r1, %r2}, %rd4;
    mov.b64 {_, %r3}, %rd4;
    sub.s32 %r2, %r2, %r3;
    mov.b64 %rd5, {%r2, %r1};
    st.global.b64 [%rd2], %rd5;"""
    assert run_snippet(device, code, [5 + (9 << 32)]).tolist() == [5 << 32]


def test_small_loads_are_extended_by_their_sign(device):
    code = """
    ld.global.s8 %r1, [%rd1];
    ld.global.u8 %r2, [%rd1+1];
    mov.b64 %rd4, {%r1, %r2};
    st.global.b64 [%rd2], %rd4;"""
    assert run_snippet(device, code, [0xFFFE]).view(I32).tolist() == [-2, 255]


@pytest.mark.parametrize(
    "operation, before, value, after",
    [
        ("add.u64", 5, 3, 8),
        ("add.u32", 2**32 - 1, 1, 0),
        ("exch.b32", 5, 3, 3),
        ("min.s32", -1 & 0xFFFFFFFF, 3, -1 & 0xFFFFFFFF),
        ("min.u32", -1 & 0xFFFFFFFF, 3, 3),
        ("max.s32", -1 & 0xFFFFFFFF, 3, 3),
        ("or.b32", 5, 2, 7),
        ("and.b32", 5, 4, 4),
    ],
)
def test_atomics_return_the_old_value(device, operation, before, value, after):
    register = "%rd5" if "64" in operation else "%r1"
    words = np.array([before], I64)
    code = f"""
    mov.b64 %rd5, 0;
    mov.b32 %r1, 0;
    atom.global.{operation} {register}, [%rd1], {value};
    cvt.u64.u32 %rd6, %r1;
    or.b64 %rd5, %rd5, %rd6;
    st.global.b64 [%rd2], %rd5;"""
    assert run_snippet(device, code, words).tolist() == [before] and words.tolist() == [after]


def test_compare_and_swap_stores_only_where_the_old_value_is_the_expected_one(device):
    words = np.array([5, 6], I64)
    code = "atom.global.cas.b32 %r1, [%rd1], 5, 9;\ncvt.u64.u32 %rd5, %r1;\nst.global.b64 [%rd2], %rd5;"
    assert run_snippet(device, code, words).tolist() == [5, 6] and words.tolist() == [9, 6]


@pytest.mark.parametrize("meets", ["", "bar.sync 0;"])
@pytest.mark.parametrize(
    "line",
    [
        "ld.global.b32 %r1, [%rd1+2];",
        "ld.global.v2.b32 {%r1, %r2}, [%rd1+4];",
        "ld.global.v4.b32 {%r1, %r2, %r3, %r4}, [%rd5+8];",
        "st.global.b64 [%rd1+4], %rd3;",
        "atom.global.add.u64 %rd4, [%rd1+4], 1;",
        "st.shared.b32 [block+1], %r9;",
        "ld.global.b32 %r1, [%rd6];",
    ],
)
def test_an_address_at_which_a_card_faults_is_an_error(device, line, meets):
    code = f"""
    and.b64 %rd5, %rd1, -16;
    mov.b64 %rd6, 8;
    {meets}
    {line}
    {meets}"""
    with pytest.raises(DeviceError, match="an address is null or misaligned in") as raised:
        run_snippet(device, code, np.zeros(4))
    assert line in str(raised.value)
    assert run_snippet(device, "st.global.b64 [%rd2], %rd3;", np.zeros(2)).tolist() == [0, 8]


@pytest.mark.parametrize(
    "line",
    [
        "add.f32 %r1, %r1, %r1;",  # may be contracted
        "add.rz.f32 %r1, %r1, %r1;",
        "add.rn.ftz.f32 %r1, %r1, %r1;",
        "div.approx.f32 %r1, %r1, %r1;",
        "mul.rn.sat.f32 %r1, %r1, %r1;",
        "fma.rm.f64 %rd5, %rd5, %rd5, %rd5;",
        "min.ftz.f32 %r1, %r1, %r1;",
        "cvt.rz.f32.f64 %r1, %rd5;",
        "cvt.sat.u32.u64 %r1, %rd5;",
        "sin.approx.f32 %r1, %r1;",
        "ex2.approx.f32 %r1, %r1;",
        "setp.lt.and.f32 %p1, %r1, %r2, %p2;",
        "ld.volatile.global.b32 %r1, [%rd1];",
        "atom.global.inc.u32 %r1, [%rd1], 3;",
        "shfl.sync.down.b32 %r1, %r2, 1, 31, -1;",
        "shfl.sync.idx.b32 %r1, %r2, 1, 31, 15;",
        "bar.sync 1;",
        "call.uni foo, ();",
        "prmt.b32 %r1, %r1, %r1, %r1;",
        "add.s32 %r1, %r44, 1;",
    ],
)
def test_an_instruction_that_is_not_known_is_an_error(device, line):
    with pytest.raises(DeviceError, match="does not know the PTX instruction") as raised:
        device.load(snippet(line))
    assert line in str(raised.value)
