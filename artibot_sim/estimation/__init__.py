"""The estimator of identification and diagnosis: measurements, windows, loss, solver, search, uncertainty."""
