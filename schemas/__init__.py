"""Every column once, the tables made of them, and their expectation suites."""
