# A room from inside
#
# The camera finds its way into a room by itself. Sun and sky come through the openings.
antumbra render godot_room.glb --size 1280x800 --spp 16 --adaptive --bounce 16 -o room.png
