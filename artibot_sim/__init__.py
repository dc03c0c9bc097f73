"""artibot: simulate, drive, record, identify and diagnose articulated eight-wheel rovers."""
