# Sun in a forest
#
# Half a million leaves and needles, as triangles; sun and sky through all of them.
antumbra render "procedural:forest?triangles=600k" --size 1280x800 --preset final --sky "#a8c8ff" \
    --light sun:-0.5,-1,-0.6@6 -o forest.png
