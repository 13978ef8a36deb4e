"""The plan `auto`: strategies to trace a query, and the choice among them.

- `query_features`: the counts and sizes that costs depend on, the spatial order of receivers, samples of a query
- `cost_model`: predicted nanoseconds per ray of each strategy, fitted to measurements and scaled to this machine
- `strategies`: a tracer over a form of the tree; the choice, and the tracer `auto`
"""
