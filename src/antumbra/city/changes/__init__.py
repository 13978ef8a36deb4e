"""Scenes with objects added and removed, and studies before and after.

- `scene_changes`: the states of a scene, which share its frame and the numbers of its faces
- `before_and_after`: two tables on the same sensors as one, with the values before, after, and their loss
"""
