"""Many independent searches (tasks x models x seeds) over any executor, resumable, and what they found side by side."""
