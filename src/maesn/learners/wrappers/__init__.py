"""What is put around a learner: a curiosity bonus, and fine-tuning of the policy's weights."""
