"""Motion tasks: what is searched, what it costs, how it is judged. Each has readable defaults in a JSON file here."""
