"""Pose geometry in NumPy, float64; batch axes lead everywhere."""
