# Viewshed of hills
#
# Three towers of 30 m on a square kilometre of hills. Colours show how many of them see the ground.
antumbra viewshed example:hills --sensors grid:2 --observer 85000,446000,0 --observer 84650,446300,0 \
    --observer 85300,445650,0 --on-surface --eye-height 30 -o hills_view.png
