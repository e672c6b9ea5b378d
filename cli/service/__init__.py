"""The service on one machine: Prefect's server and a worker, kept running."""
