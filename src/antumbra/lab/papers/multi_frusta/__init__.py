"""Multi-frusta tracing as published [Benthin and Wald 2009].

- `published_frusta`: the tracers `multifrusta:paper`, `:leaf-boxes`, `:corners` and `:full`
- `primary_frusta`: primary rays, from the root or from entry points (Sec. 4.4, 7); `hit_intervals`: their hits
- `moeller_trumbore`: packets of 16 shadow rays or primary rays (Sec. 5.1)
- `large_packets`: packets of 256 shadow rays (Sec. 5.2)
- `frusta_published`: the paper's figures
- `frusta_measurements`: measures the tables and figures
- `frusta_tables`, `frusta_plots`: print and draw them
"""
