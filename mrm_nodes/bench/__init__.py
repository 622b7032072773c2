"""What things cost: the nodes, whole surfaces, the evaluator, a run of the regression, and a suite of thousands."""
