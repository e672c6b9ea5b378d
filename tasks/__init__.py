"""One module a stage: reads, calls the domain, writes, logs counts. No algorithm."""

import facadelake  # noqa: F401  (before Prefect is imported: switches telemetry off)
