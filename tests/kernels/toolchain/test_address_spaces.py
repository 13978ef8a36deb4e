"""Every pointer of a device kernel gets the space of the memory that it points to."""

import re

import pytest

from antumbra.kernels.toolchain.address_spaces import with_address_spaces
from antumbra.kernels.toolchain.device_ir import parsed, without_target

HEAD = """
declare ptr @antumbra.device.local.16.32()
declare void @llvm.memset.p0.i64(ptr, i8, i64, i1)
declare void @llvm.memcpy.p0.p0.i64(ptr, ptr, i64, i1)
declare void @llvm.lifetime.start.p0(ptr)
declare i64 @llvm.ctpop.i64(i64)
define void @entry(i64 %a, i64 %b) {
  %own = alloca [4 x i64], align 16
  %one = inttoptr i64 %a to ptr
  %two = inttoptr i64 %b to ptr
  %block = tail call ptr @antumbra.device.local.16.32()
"""


def converted(body):
    """The kernel with a body, converted and accepted by LLVM."""
    text = with_address_spaces(without_target(str(parsed(f"{HEAD}{body}\n  ret void\n}}\n"))))
    parsed(text)
    return text


@pytest.mark.parametrize(
    "body, expected",
    [
        ("store i64 1, ptr %one", "store i64 1, ptr addrspace(1) %one"),
        ("store i64 1, ptr %own", "store i64 1, ptr %own"),
        ("store i64 1, ptr %block", "store i64 1, ptr addrspace(3) %block"),
        ("%p = getelementptr i64, ptr %block, i64 %a\n store i64 1, ptr %p", "store i64 1, ptr addrspace(3) %p"),
        ("%p = select i1 true, ptr %one, ptr %two\n store i1 1, ptr %p", "addrspace(1) %one, ptr addrspace(1) %two"),
        ("%p = select i1 true, ptr null, ptr %two\n store i1 1, ptr %p", "addrspace(1) null, ptr addrspace(1) %two"),
        ("%p = freeze ptr %two\n store i64 1, ptr %p", "freeze ptr addrspace(1) %two"),
        ("%c = icmp eq ptr %one, null\n store i1 %c, ptr %own", "icmp eq ptr addrspace(1) %one, null"),
        ("%n = ptrtoint ptr %two to i64\n store i64 %n, ptr %own", "ptrtoint ptr addrspace(1) %two to i64"),
        ("%x = atomicrmw add ptr %block, i64 1 monotonic", "atomicrmw add ptr addrspace(3) %block, i64 1"),
        ("call void @llvm.lifetime.start.p0(ptr %own)\n store i64 1, ptr %own", "store i64 1, ptr %own"),
        (
            "call void @llvm.memset.p0.i64(ptr %two, i8 0, i64 8, i1 false)",
            "declare void @llvm.memset.p1.i64(ptr addrspace(1)",
        ),
        (
            "call void @llvm.memcpy.p0.p0.i64(ptr %own, ptr %two, i64 8, i1 false)",
            "@llvm.memcpy.p0.p1.i64(ptr %own, ptr addrspace(1) %two",
        ),
        (
            "br i1 true, label %l, label %m\nl:\n br label %m\nm:\n"
            "%p = phi ptr [ %one, %l ], [ %two, %0 ]\n store i64 1, ptr %p",
            "phi ptr addrspace(1) [ %one, %l ], [ %two, %0 ]",
        ),
    ],
)  # fmt: skip
def test_an_instruction_names_the_spaces_of_its_pointers(body, expected):
    assert expected in converted(body)


def test_a_loop_over_a_pointer_has_one_space():
    text = converted(
        """br label %l
l:
  %p = phi ptr [ %one, %0 ], [ %q, %l ]
  %q = getelementptr i8, ptr %p, i64 8
  store i64 1, ptr %q
  %c = icmp eq ptr %q, %two
  br i1 %c, label %m, label %l
m:"""
    )
    assert "phi ptr addrspace(1)" in text and "icmp eq ptr addrspace(1) %q, %two" in text


def test_memory_of_blocks_is_one_array_that_holds_all_its_parts():
    text = converted("store i64 1, ptr %block")
    assert re.search(r"@antumbra_local = internal addrspace\(3\) global \[48 x i8\]", text)
    assert "getelementptr i8, ptr addrspace(3) @antumbra_local, i64 16" in text


@pytest.mark.parametrize(
    "body, message",
    [
        ("%p = select i1 true, ptr %one, ptr %own\n store i64 1, ptr %p", "may point to memory of two kinds"),
        ("%c = icmp eq ptr %one, %block\n store i1 %c, ptr %own", "may point to memory of two kinds"),
        ("%p = load ptr, ptr %own\n store i64 1, ptr %p", "keeps a pointer in memory"),
    ],
)
def test_a_pointer_of_unknown_kind_is_an_error(body, message):
    with pytest.raises(TypeError, match=message):
        converted(body)
