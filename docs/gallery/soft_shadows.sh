# Soft shadows
#
# A courtyard below a square lamp. Each pixel sends 64 shadow rays, and more in penumbrae; 16 diffuse rays bring the
# light that the walls return.
antumbra render "procedural:atrium?triangles=400k" --size 1280x800 --preset final --bounce 16 -o soft_shadows.png
