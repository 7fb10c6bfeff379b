"""Joints between pieces of a path that share no tracks, by direct alignment."""
