"""Elevations: facades in orthographic view, coloured by rectified photographs."""
