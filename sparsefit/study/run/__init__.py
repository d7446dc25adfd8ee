"""Every planned case becomes a row."""
