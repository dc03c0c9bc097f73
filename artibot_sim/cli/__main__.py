"""``python -m artibot_sim.cli``."""

import sys

from artibot_sim.cli import main

sys.exit(main())
