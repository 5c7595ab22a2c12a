"""Analytic and published benchmarks: `restore bench`."""
