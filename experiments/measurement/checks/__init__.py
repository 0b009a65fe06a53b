"""May a log be believed? What may be wrong with its rows, columns and clock, each named for what it is."""
