"""Detections to observations on the surface, observations to defects."""
