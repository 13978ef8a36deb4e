# Where rays spend their steps
#
# Boxes tested for the shadow rays of each pixel, by a tree for random order and by one that is built for these rays.
antumbra explain "procedural:forest?triangles=300k" --size 640x480 -o heat_map.png
