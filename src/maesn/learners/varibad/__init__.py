"""VariBAD: a recurrent belief about the task, learned by variational inference, and acted on."""
