"""Data on disk: BOP folders, estimate files and multi-camera recordings. Millimetres end and begin here."""
