"""Georeferenced bundle adjustment: tie points, control, GPS, attitudes and the building's model in one estimate."""
