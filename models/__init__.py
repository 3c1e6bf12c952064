"""The network as torch modules, and nothing else: no data, no losses, no files."""
