"""Facadelake: photographs of a building in, versioned tables of its facade defects out."""

from facadelake.core.environment import set_environment_defaults

set_environment_defaults()
