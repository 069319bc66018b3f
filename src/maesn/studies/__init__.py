"""Comparisons of many runs and methods on the same tasks."""
