"""Detections in photographs: imported from a COCO file, or made by an ONNX model that a card describes."""
