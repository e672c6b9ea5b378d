"""Lenses of photographs: which one, its focal length, its zoom."""
