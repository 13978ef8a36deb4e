# Plans side by side
#
# The picture of `antumbra compare`: the tests of boxes and triangles per ray, by three tracers that give the same bits.
antumbra compare "procedural:atrium?triangles=200k" --size 512x512 --rounds 3 --plan bsah+single --plan bsah+wide \
    --plan bsah+multifrusta -o comparison.png
