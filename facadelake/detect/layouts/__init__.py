"""Output layouts of detectors: one reader for each family, one table of them, and the check of a probe image."""
