"""Commands, controls and motion of the ego."""
