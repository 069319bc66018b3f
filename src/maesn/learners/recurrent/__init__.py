"""RL2: learning inside a task is what a recurrent policy does."""
