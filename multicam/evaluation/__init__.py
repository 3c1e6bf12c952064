"""Errors of poses against ground truth, and tables of them; nothing here sees an image or a network."""
