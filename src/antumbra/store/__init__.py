"""Scenes in a file of pages: chunks of triangles, each with its BVH, of which only what is looked at is in memory."""
