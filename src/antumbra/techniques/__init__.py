"""Published techniques for shadow rays, one folder each.

- `culling/`: pre-BVH culling [Selgrad et al. 2015]
- `srdh/`: BVHs built for a sample of the shadow rays [Feltman et al. 2012]
- `rayhierarchy/`: hierarchies over rays [Olsson and Assarsson 2011]
- `chcrt/`: CHC+RT [Mattausch et al. 2015]
- `tracer_options`: options of the tracers

Multi-frusta tracing [Benthin and Wald 2009] is in `trace/frusta/`.
"""
