"""Many scenes at once: worker processes on this machine or a Ray cluster, and the check of what they made."""
