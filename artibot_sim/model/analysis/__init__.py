"""What the model says of itself: influence (eq. 24) and how long a step may be."""
