# Culling before a BVH is built
#
# Orange triangles may meet a shadow ray of the picture on the left. All blue ones are dropped before the build.
antumbra culling "procedural:museum?triangles=300k" --size 640x640 -o culling.png
