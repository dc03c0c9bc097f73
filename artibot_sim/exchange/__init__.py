"""Recordings and robots for other programs: what a bag holds, tables of it, bags from logs, robots as other formats."""
