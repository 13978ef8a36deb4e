"""Photovoltaic modules: how much of each is shaded, by time.

- `modules`: `PvModule`, fixed or on a tracker, and tables of modules
- `pv_options`: options of the study
- `module_shading`: `module_shading`, for many modules in one call
"""
