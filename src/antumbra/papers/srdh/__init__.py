"""[Feltman et al. 2012], as published: `variants`; its figures and Table 1: `measure`, `times`, `plot`."""
