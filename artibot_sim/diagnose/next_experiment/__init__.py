"""What to measure next: the cheapest manoeuvre that would tell."""
