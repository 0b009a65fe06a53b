"""The one error a user may see: a sentence that says what is wrong and what to do (exit code 2)."""


class UserError(Exception):
    """Bad input from outside; its message is printed as it stands, without a traceback."""
