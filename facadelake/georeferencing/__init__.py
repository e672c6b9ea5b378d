"""georeferencing."""
