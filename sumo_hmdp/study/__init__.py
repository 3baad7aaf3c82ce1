"""Runs, their records and their tables."""
