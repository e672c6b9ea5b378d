"""Prefect flows: which tasks run, in which order."""

import facadelake  # noqa: F401  (before Prefect is imported: switches telemetry off)
