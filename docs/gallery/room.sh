# A room from inside
#
# The camera finds its way into a room by itself. Sun and sky come through the openings.
antumbra render example:room --size 1024x640 --adaptive --bounce 8 -o room.png
