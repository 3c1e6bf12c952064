"""multicam-pose: poses of several cameras on the fly, from known objects they happen to see."""

__version__ = "0.1.0"
