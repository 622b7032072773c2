"""Which cases there are: the default suite, and a user's, from TOML."""
