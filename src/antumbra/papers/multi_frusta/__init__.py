"""Multi-frusta tracing as published [Benthin and Wald 2009].

- `published_frusta`: the tracers `multifrusta:...`
- `packet_baselines`: packets of 256 shadow rays (Sec. 5.2), and of 16 primary rays
- `frusta_measurements`: measures and prints the tables, and measures and draws the figures
"""
