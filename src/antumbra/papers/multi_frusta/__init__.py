"""Multi-frusta tracing as published [Benthin and Wald 2009].

- frusta, cornerrays, frustaleaf: the tracers `multifrusta:...`
- packet256: the packets of Sec. 5.2
- measure, published, command: ``antumbra bench multi-frusta``
"""
