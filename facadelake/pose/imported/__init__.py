"""Poses that another program found: read, brought into site, judged."""
