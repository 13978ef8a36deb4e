"""[Selgrad et al. 2015], as published: `lines`; its tables and figures: `measure`, `plot`."""
