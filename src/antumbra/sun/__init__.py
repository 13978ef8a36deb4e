"""The sun over a place: where a scene lies on Earth, and where the sun stands in its frame.

- `location`: `Place`: latitude, longitude, time zone and true north of a scene
- `sun_positions`: time intervals and the sun position of each
"""
