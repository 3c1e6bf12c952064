"""Pictures and recordings with exact labels, rendered with Blender."""

GENERATOR_VERSION = 3
"""Raise it with every change after which a configuration and seed give other labels or other pixels."""
