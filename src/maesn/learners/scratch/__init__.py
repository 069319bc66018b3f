"""Learners that begin anew in every task: REINFORCE and TRPO; and agents that learn nothing."""
