# Your own model
#
# A model in sun and sky: the camera frames the part that has detail.
antumbra scenes city --triangles 300k -o city.glb
antumbra render city.glb --size 1024x640 --adaptive --light sun:0.8,-0.9,-0.5@4 --sky white -o model_first.png
