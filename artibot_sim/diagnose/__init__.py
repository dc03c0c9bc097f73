"""What a simulation gets wrong, where, why, how sure that is, what mending it gains, and what to measure next."""
