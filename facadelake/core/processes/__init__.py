"""Work in a process of its own, for native libraries that can crash.

The worker is a module run as ``python -m MODULE JOB.json``. It writes events, one JSON object a line, on what was its
standard output; all other output goes to its log.
"""
