"""Cracks measured in photographs: length and width in pixels, with an error, or the limit below which none is told."""

from facadelake.detect.measure.photographs import measure_detections

__all__ = ["measure_detections"]
