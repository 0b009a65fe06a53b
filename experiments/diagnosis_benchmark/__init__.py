"""How often is the diagnosis right? Logs of an independent plant, its sealed truth, and what users would do instead."""
