# A horizon
#
# What hides the sky from a point above a street, with the paths of the sun.
antumbra skyline example:village --point 85000,446000,27.5 --map horizon.png
