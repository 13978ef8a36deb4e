# Terrain
#
# A height raster, coloured by height, in the light of a low sun: ridges cast long shadows.
antumbra render example:hills --size 1280x800 --preset final --light sun:0.9,-0.35,-0.4@6 --sky "#56719c" \
    --camera 84640,445430,420:85030,446020,60:44 --ground off -o hills.png
