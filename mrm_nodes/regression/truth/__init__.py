"""What a case ought to look like: the closure tree of a material in the evaluator, with the bounds of float32."""
