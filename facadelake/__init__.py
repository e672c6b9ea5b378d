"""Facadelake: photographs of a building in, versioned tables of its facade defects out."""

from facadelake.quiet import silence

silence()
