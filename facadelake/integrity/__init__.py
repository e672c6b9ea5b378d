"""The as-built surface against the building model."""
