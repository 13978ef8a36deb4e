# A museum
#
# Halls of sculptures in the light of one window, with 16 diffuse rays from each pixel.
antumbra render "procedural:museum?triangles=300k" --size 1280x800 --spp 16 --adaptive --bounce 16 -o museum.png
