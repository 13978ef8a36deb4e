# The first picture
#
# What the command of the README renders: a courtyard in the sun.
antumbra render --size 1280x800 -o first.png
