"""Gradient-based meta-learning: MAESN, MAML, MAML + bias and LatentSpace are one learner."""
