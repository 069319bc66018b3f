"""Experience: who acts, the episodes that were played, and the transitions in them."""
