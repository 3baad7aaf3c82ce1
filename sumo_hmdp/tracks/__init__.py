"""Recorded traffic: files of tracks, the road they drove on, and the tracks along that road."""
