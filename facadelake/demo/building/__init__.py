"""Geometry of the demo building and its IFC file."""
