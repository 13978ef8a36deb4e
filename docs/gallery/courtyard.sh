# San Miguel
#
# Two million triangles: a courtyard with sun, sky, and the light that its walls return.
antumbra render sanmiguel_lite.glb --size 1280x800 --adaptive --bounce 8 -o courtyard.png
