"""Prefect flows: which tasks run, in which order."""

import facadelake  # noqa: F401  (before Prefect is imported: switches telemetry off)
from facadelake.core.code_version import compute_code_version

# The code is identified before its modules are loaded: what is edited while a run goes on is then noticed.
compute_code_version("flows.inspect_building")
