"""The tracer `chcrt`, apart from its kernels, so that other plans start sooner."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from ...base.progress import ProgressCallback
from ...bvh.nodes import Bvh
from ...query.shadow_query import ShadowQuery
from ...trace.tracer import Bits, Counters, Form, Tracer
from ..tracer_options import ChcRtOptions

if TYPE_CHECKING:
    from .chc_rt import ChcRtState

MATTAUSCH = "Mattausch et al. 2015, CHC+RT: coherent hierarchical culling for ray tracing"


class ChcRtTracer(Tracer):
    """Occlusion queries for pairs of screen tiles and subtrees (CHC+RT). It can also trace stores."""

    paper = MATTAUSCH

    def __init__(self, options: ChcRtOptions, description: str):
        self.options, self.description = options, description
        self.form = Form("parts", self._state_of)

    @property
    def exact(self) -> bool:
        return self.options.threshold == 0

    def _state_of(self, bvh: Bvh, threads: int | None = None) -> "ChcRtState":
        from .chc_rt import prepare

        return prepare(bvh, self.options, threads)

    def trace(
        self,
        prepared: Any,
        query: ShadowQuery,
        bits: Bits,
        threads: int | None = None,
        counters: Counters | None = None,
        progress: ProgressCallback | None = None,
        fresh: bool = True,
    ) -> None:
        self.trace_all(prepared, [query], [bits], threads, counters, progress, fresh)

    def trace_all(
        self,
        prepared: Any,
        queries: Sequence[ShadowQuery],
        bits: Sequence[Bits],
        threads: int | None = None,
        counters: Counters | None = None,
        progress: ProgressCallback | None = None,
        fresh: bool = True,
    ) -> None:
        from .chc_rt import trace_shadows

        if not fresh:
            for words in bits:
                words[...] = 0  # every segment is traced
        trace_shadows(prepared, queries, bits, threads, counters, progress)
