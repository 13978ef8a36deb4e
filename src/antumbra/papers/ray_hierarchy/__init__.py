"""[Olsson and Assarsson 2011], as published: `cones`, `cone_triangle`, `variants`; its figures: `measure`, `plot`."""
