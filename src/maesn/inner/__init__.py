"""From experience to change inside one task: advantages, the surrogate losses, the inner update."""
