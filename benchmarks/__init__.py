"""Benchmarks of accuracy, run time and memory. They print figures; tests assert none of them."""
