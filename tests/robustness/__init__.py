"""Damaged and edited files through every command that reads: ``python -m tests.robustness --help``."""
