"""Defect detectors, and detections made elsewhere."""
