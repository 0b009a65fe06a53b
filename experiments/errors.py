"""The one error a user may see: a sentence that says what is wrong and what to do (exit code 2)."""


class UserError(Exception):
    """Bad input from outside; its message is printed without a traceback, on one line whatever was quoted in it."""

    def __init__(self, sentence: str) -> None:
        super().__init__("".join(c if c.isprintable() else repr(c)[1:-1] for c in sentence))
