"""Region factor: where the colours along the contour's normals say that the border of an object lies."""
