"""The command `starleth`: one file a subcommand, which imports what it needs when it runs. Nothing here to import."""
