# A room from inside
#
# The camera finds its way into a room by itself. A closed room gets a lamp, whose light bounces off walls and floor.
antumbra render example:room --size 1024x640 --preset final -o room.png
