"""SRDH as published [Feltman et al. 2012]: `variants`. Its figures and Table 1: `measure`, `times`, `plot`."""
