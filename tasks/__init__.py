"""Tasks: one module per stage. A task reads, calls the domain, writes and logs counts; it holds no algorithm."""

import facadelake  # noqa: F401  (before Prefect is imported: switches telemetry off)
