"""The plan `auto`: strategies to trace a query, and the choice among them.

- `query_features`: the counts and sizes that determine the cost, spatial sorting of receivers, samples of a query
- `cost_model`: predicted nanoseconds per ray of each strategy, fitted to measurements and scaled to this machine
- `strategies`: pairs of a tracer and a form of the tree, the choice among them, and the tracer `auto`
"""
