"""Facadelake: photographs of a building in, versioned tables of its facade defects out.

``import facadelake as fl`` gives the names of ``__init__.pyi``; each is imported when it is first used.
"""

import lazy_loader

from facadelake.core.environment import set_environment_defaults

set_environment_defaults()
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
