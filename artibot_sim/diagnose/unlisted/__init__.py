"""Forces on no list: what is left when no known effect explains the data."""
