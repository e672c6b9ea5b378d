"""The demo building: an IFC, photographs, boxes and truth, all made from one recipe."""
