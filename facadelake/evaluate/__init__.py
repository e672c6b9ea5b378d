"""A campaign's results against truth: the figures of an inspection. Nothing that makes a result reads truth."""
