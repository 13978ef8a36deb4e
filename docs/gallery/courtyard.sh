# San Miguel
#
# Two million triangles: a courtyard with sun, sky, and the light that its walls return.
antumbra render sanmiguel_lite.glb --size 1280x800 --preset final --bounce 32 -o courtyard.png
