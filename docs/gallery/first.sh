# The first picture
#
# What the command of the README renders: a courtyard under a square lamp.
antumbra render --size 1280x800 -o first.png
