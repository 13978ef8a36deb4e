"""[Mattausch et al. 2015]: aggressive thresholds (`variants`); its tables: `measure`, `stores`, `tables`, `plot`."""
