"""The choice of methods: which tracer answers a query, by counts known before and by a sample of its rays.

- `facts`: the counts that costs depend on.
- `rates`: predicted nanoseconds a ray of each way, fitted to measurements and scaled to this machine.
- `sample`: a small query cut from a query, to try ways on.
- `order`: scattered receivers in an order in which neighbours are near.
- `ways`: the ways to trace a query, and the trees that they walk.
- `choose`: the choice, and what earlier frames have measured.
- `trace`: the tracer `auto`.
"""
