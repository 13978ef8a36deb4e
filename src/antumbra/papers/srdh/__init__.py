"""SRDH as published [Feltman et al. 2012]: `variants`.

`measure`, `times`, `tables` and `plot` make its figures and Table 1; `rtsah` checks RTSAH.
"""
