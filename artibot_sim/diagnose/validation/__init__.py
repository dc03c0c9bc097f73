"""What a model is worth: predictions, residuals, stability of what was fitted."""
