"""Identification: parameters of the model from recordings, with intervals.

>>> from artibot_sim.experiment import read_bag
>>> from artibot_sim.identify import identify
>>> from artibot_sim.model import load_robot, save_robot
>>> work = identify([read_bag("run0"), read_bag("run1")], load_robot("agriq"), holdout=[read_bag("run2")])
>>> print(work.result)
>>> save_robot(work.result.robot, "field.yaml")
"""

from artibot_sim.estimation.parameters import SOIL, Prior
from artibot_sim.estimation.search import Effort
from artibot_sim.identify.requested import parse_priors
from artibot_sim.identify.result import ChannelFit, Estimate, FitStatus, Identification, Prediction
from artibot_sim.identify.run import WINDOW, Work, identify

__all__ = [
    "SOIL",
    "WINDOW",
    "ChannelFit",
    "Effort",
    "Estimate",
    "FitStatus",
    "Identification",
    "Prediction",
    "Prior",
    "Work",
    "identify",
    "parse_priors",
]
