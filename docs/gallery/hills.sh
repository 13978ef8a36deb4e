# Terrain
#
# A height raster, coloured by height. Over flat scenes the default sun is low, so ridges cast shadows.
antumbra render example:hills --size 1280x800 --preset final -o hills.png
