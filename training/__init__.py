"""Training of the shipped detector (README.md). No other package imports this one."""
