"""The plan `auto`: the choice of a tracer for each query, among those that state their cost.

- `query_features`: the counts and sizes that determine the cost, spatial sorting of receivers, samples of a query
- `cost_model`: predicted seconds of rays and trees, scaled to this machine
- `strategies`: trees in the forms of tracers, the choice among tracers, and the tracer `auto`
"""
