"""Pre-BVH culling as published [Selgrad et al. 2015]: `lines`. Its tables and figures: `measure`, `plot`."""
