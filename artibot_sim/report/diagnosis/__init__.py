"""A diagnosis as a page, its charts and its files."""
