"""The verbs of `multicam datagen`."""
