"""Hostile input to every reader of a file from outside."""
