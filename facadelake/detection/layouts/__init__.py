"""Output layouts of detectors: how output tensors become candidates."""
