"""What a simulation gets wrong, where, why, how sure that is, what mending it gains, and what to measure next.

>>> from artibot_sim.diagnose import diagnose
>>> from artibot_sim.experiment import read_bag
>>> from artibot_sim.model import load_robot
>>> found = diagnose([read_bag("run0"), read_bag("run1")], load_robot("agriq"), holdout=[read_bag("run2")])
"""

from artibot_sim.diagnose.pipeline import diagnose
from artibot_sim.diagnose.records import Options
from artibot_sim.diagnose.result import Diagnosis
from artibot_sim.diagnose.verdict import Verdict

__all__ = ["Diagnosis", "Options", "Verdict", "diagnose"]
