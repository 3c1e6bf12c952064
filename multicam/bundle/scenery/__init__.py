"""What pictures share beside the objects: points that nobody knows, matched between two pictures."""
