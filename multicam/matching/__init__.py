"""Which estimates of different views show the same object, and what that says about the cameras."""
