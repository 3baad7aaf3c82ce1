"""The closed loop and the bridge to SUMO."""
