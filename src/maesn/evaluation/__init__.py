"""What a learner does in new tasks: adaptation, its tables, records of exploration, and films."""
