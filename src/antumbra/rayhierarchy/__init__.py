"""Improved ray hierarchies [Olsson and Assarsson 2011]: over the shadow rays, and none over the scene."""
