"""Printed tables and figures of the five papers beside ours; see ``python -m benchmarks.papers --help``."""
