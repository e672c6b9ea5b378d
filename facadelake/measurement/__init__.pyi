from .campaign import measure_detections as measure_detections
