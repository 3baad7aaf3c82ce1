"""Scenario files and their validation."""
