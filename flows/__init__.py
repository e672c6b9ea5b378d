"""What runs, in which order; the command line."""

import facadelake  # noqa: F401  (before Prefect is imported: switches telemetry off)
