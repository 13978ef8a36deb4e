# Sun and sky
#
# What a file without lights looks like: a sun to the left of the camera, and soft daylight from the whole sky.
antumbra render example:temple --size 900x1125 --preset final -o sun_and_sky.png
