"""PEARL: a posterior over the task from its transitions, and off-policy learning on top."""
