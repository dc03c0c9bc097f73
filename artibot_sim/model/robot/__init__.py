"""A robot: its quantities, its file, its parameters as compiled code takes them."""
