"""Reports: single HTML files that need no network."""
