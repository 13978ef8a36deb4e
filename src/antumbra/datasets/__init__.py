"""Data sets: pictures of a scene from many cameras under many lights, with object, face and blocker ids.

- `dataset_options`: options, with their checks
- `dataset`: `dataset`, which renders unfinished frames
- `random_views`: cameras and lights, explicit or random from a seed
- `frame_lights`: random lights of a frame, which light what its camera sees
- `dataset_layers`: layer names and values, and blocker ids
- `dataset_files`: the folder, finished frames, and contact sheets
"""
