"""Measurements, written to docs/performance.md by `make bench`."""
