"""What is measured, and against what; never asserted in tests."""
