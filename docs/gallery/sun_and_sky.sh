# Sun and sky
#
# What a file without lights looks like: a sun of half a degree, and a soft daylight of 256 directions.
antumbra render example:temple --size 900x1125 --preset final -o sun_and_sky.png
