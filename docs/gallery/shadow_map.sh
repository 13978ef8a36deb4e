# Shadow hours
#
# Shadow hours in a village at the equinox, in classes, as a map. As .gpkg, they are polygons.
antumbra shadow example:village --days 2026-03-21 --cell 1 --classes 0,2,4,6,8 --timezone Europe/Amsterdam \
    --map shadow_map.png
