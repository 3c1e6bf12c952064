"""CAD of any kind to a BOP models folder: units, meshes, proposals of symmetries."""
