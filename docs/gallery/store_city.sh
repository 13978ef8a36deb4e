# A city in a store
#
# Two million triangles, built once into a file, and rendered with at most 600 MB of memory.
antumbra build "procedural:city?triangles=2M" -o city.antumbra --max-memory 1G
antumbra render city.antumbra --max-memory 600M --size 1024x640 --light sun:-0.7,-0.8,0.4@4 -o store_city.png
