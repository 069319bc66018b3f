"""Learners without meta-training: REINFORCE, TRPO, fine-tuning, and what learns nothing."""
