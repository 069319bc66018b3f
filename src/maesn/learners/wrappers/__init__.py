"""Wrappers of learners: a curiosity bonus, and fine-tuning of the policy's weights."""
