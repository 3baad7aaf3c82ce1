"""Drivers of the surrounding vehicles."""
