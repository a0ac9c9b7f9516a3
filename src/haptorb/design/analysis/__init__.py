"""What the results of a design say: the Pareto front, a few designs to look at, and what each parameter does."""
