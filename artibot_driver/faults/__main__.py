"""``python -m artibot_driver.faults``."""

import sys

from artibot_driver.faults.campaign import main

if __name__ == "__main__":
    sys.exit(main())
