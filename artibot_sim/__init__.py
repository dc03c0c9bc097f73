"""artibot: simulate, record and replay articulated eight-wheel rovers."""
