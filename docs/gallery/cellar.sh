# A cellar
#
# Vaults on several levels, and one lamp. Culling drops most of its triangles before a tree is built.
antumbra render "procedural:cellar?triangles=250k" --plan grid32+lbvh+multifrusta --size 1280x800 --spp 16 --adaptive \
    --bounce 16 -o cellar.png
