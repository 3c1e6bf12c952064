"""Sparse viewpoint models: what the contour and the surface of a mesh look like from all around."""
