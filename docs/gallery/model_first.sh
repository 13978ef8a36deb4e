# Your first picture
#
# A model, and no options: the camera finds what has detail, and sun and sky shine.
antumbra scenes city --triangles 300k -o city.glb
antumbra render city.glb --size 1024x640 --adaptive --light sun:0.8,-0.9,-0.5@4 --sky white -o model_first.png
