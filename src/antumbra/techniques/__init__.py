"""Published techniques for shadow rays, one folder each.

- `culling/`: pre-BVH culling [Selgrad et al. 2015]
- `srdh/`: representative rays for the SRDH builder [Feltman et al. 2012]
- `rayhierarchy/`: hierarchies over rays [Olsson and Assarsson 2011]
- `chcrt/`: CHC+RT [Mattausch et al. 2015]
- `tracer_options`: options of ray hierarchies and of CHC+RT

Multi-frusta tracing [Benthin and Wald 2009] is in `trace/frusta/`.
"""
