"""The experiment of the paper, as batches of trajectories: scenarios, methods, table, figures."""
