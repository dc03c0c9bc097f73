"""The one exception a user is meant to read."""

from __future__ import annotations


class ArtibotError(ValueError):
    """Bad input, said in one line.

    The message names what is wrong and where (file, key or topic), what was found, what was expected, and
    the mend. Command lines print it as it is and exit with status 2.
    """
