"""From scenes to labelled pictures on disk."""
