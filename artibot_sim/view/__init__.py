"""Rovers in three dimensions, in a browser on this machine: recordings with a time slider, and live."""
