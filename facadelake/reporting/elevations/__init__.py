"""elevations."""
