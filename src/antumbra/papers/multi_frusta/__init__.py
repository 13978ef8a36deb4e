"""Multi-frusta tracing as published [Benthin and Wald 2009].

- frusta, cornerrays, frustaleaf, order: the tracers `multifrusta:...`
- packet256: the packets of Sec. 5.2
- primary: packets of primary rays
- measure, quality, published, command, plot: ``antumbra bench multi-frusta``
"""
