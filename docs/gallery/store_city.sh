# A city in a store
#
# Five million triangles, built once into a file, and rendered with at most 600 MB of memory.
antumbra build "procedural:city?triangles=5M" -o city.antumbra --max-memory 1G
antumbra render city.antumbra --max-memory 600M --size 1280x800 --light sun:-0.7,-0.8,0.4@4 -o store_city.png
