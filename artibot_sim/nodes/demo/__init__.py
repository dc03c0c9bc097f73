"""`artibot demo`: plan, drive, record, replay and plot, as processes of their own."""
