"""The loop: what persons say of detections, training sets made of it, and whether a new model may replace the old."""
