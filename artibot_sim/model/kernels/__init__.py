"""What makes the model fast: compilation, layout, steps, loops, lanes."""
