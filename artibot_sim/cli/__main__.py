"""``python -m artibot_sim.cli``."""

import sys

from artibot_sim.cli import program

sys.exit(program())
