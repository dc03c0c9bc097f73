"""The version, in the one place that ``setup.py`` and ``artibot --version`` read; package.xml repeats it."""

__version__ = "0.1.0"
