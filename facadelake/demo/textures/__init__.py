"""Textures of the demo building and its surroundings, with defects, control points and light."""
