"""Bounding volume hierarchies: their nodes, the methods that build them, and how good they are."""
