"""Facadelake: photographs of a building in, versioned tables of its facade defects out."""

from facadelake.core.environment import silence

silence()
