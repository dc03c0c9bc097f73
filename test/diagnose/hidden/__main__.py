"""``python -m diagnose.hidden``, see `campaign`."""

import sys

from diagnose.hidden.campaign import main

if __name__ == "__main__":
    sys.exit(main())
