"""What stands in a scene: plain data, drawn at random from a configuration and a seed. NumPy only, no Blender."""
