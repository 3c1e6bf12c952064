"""Recordings of several cameras over time, with their errors."""
