"""The kernels of `ploc` on devices: no launch waits for threads or counts atomically, and all are known."""

from antumbra.trace.device.ploc_kernels import PLOC_KERNELS


def test_no_launch_waits_for_threads_or_counts_atomically():
    """Then the launches need no assumption about which threads of a card run at a time."""
    for name, kernel in PLOC_KERNELS.items():
        text = kernel.code("ptx").code.decode()
        assert not [word for word in ("bar.", "atom.", "red.", "shfl.", "vote.", "membar") if f"\t{word}" in text], name
