"""Runs: directories, checkpoints, the training loop, and what other programs are handed."""
