"""Wrappers of learners: a bonus for what is new, beside the reward."""
