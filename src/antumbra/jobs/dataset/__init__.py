"""Data sets: pictures of a scene by many cameras and lights, with ids of what each pixel sees and what shades it.

- make: `dataset`, which renders the frames that are not finished
- views: the cameras and lights that are asked for; drawn: those that a seed decides
- layers: names and values of the layers; blockers: the face between a pixel and a light
- sheet: a frame's layers as one picture
- files: the folder, and which frames are finished; manifest: what is recorded
"""
