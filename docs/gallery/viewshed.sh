# Viewshed
#
# Four observers in the streets of a city. Colours show how many of them see a surface.
antumbra viewshed "procedural:city?triangles=100k" --sensors grid:0.5 --on-surface --eye-height 1.6 \
    --observer=7,0,10 --observer=7,0,-20 --observer=-15,0,7 --observer=20,0,7 \
    --camera 40,80,50:0,0,-2:45 -o viewshed.png
