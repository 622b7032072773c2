"""What is compared, how far apart it may be, and what became of a case."""
