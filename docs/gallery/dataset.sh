# Layers of a data set
#
# One frame of `antumbra dataset`: picture, depth, normals and objects; for each light its visibility and what blocks it.
antumbra dataset example:town -o town --camera 20,30,-8:-40,-2,2:50 --size 480x360 \
    --light=sun:-0.6,-0.7,-0.5@3 --light=sphere:-12,14,3:2@1500 --contact-sheet dataset.png
