# Your first picture
#
# A model, and no options: the camera finds what has detail, and sun and sky shine.
antumbra scenes city --triangles 400k -o city.glb
antumbra render city.glb --size 1280x800 --preset final --light sun:0.8,-0.9,-0.5@4 --sky white -o model_first.png
