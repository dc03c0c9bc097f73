"""The model in plain NumPy, slowly and literally: where a reader begins."""
