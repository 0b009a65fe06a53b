"""Least squares in the full replay: variables, nominal numbers that may be off, the refit, what it leaves."""
