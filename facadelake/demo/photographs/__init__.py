"""Flights over the demo building: poses, visible defects, annotations, rendered photographs and their metadata."""
