"""Sheets for reports: pages with maps, diagrams, tables, the method and the sources.

- `sheet_options`: paper, scale, extent, labels and title block, and the option ``--sheet``
- `sheet`: the pages of a result; `page`: their layout; `page_text`: the widths of texts
- `map_frame`: scale, extent, coordinates and north; `map_labels`: labels that do not overlap
- `scene_plan`: outlines and hillshades of scenes from above
- `sheet_tables`, `method_facts`, `sun_paths`, `units_text`: what the further pages show
"""
