# Terrain
#
# A raster of heights: colours follow the height, and the default sun is low over flat scenes, so that ridges cast shadows.
antumbra render example:hills --size 1280x800 --preset final -o hills.png
