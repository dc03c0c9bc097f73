"""What a diagnosis tries: effects, discs of ground, and the screening of both."""
