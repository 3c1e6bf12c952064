"""Depth factor: measured points against the planes of the object's surface."""
