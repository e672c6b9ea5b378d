"""How the shipped detector is made; a package of its own that nobody imports (README.md)."""
