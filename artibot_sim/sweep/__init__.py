"""Sweeps: many simulations over a grid or a Latin hypercube of parameters, their measures as a Parquet table.

>>> from artibot_sim.sweep import plan_from_dict, sweep
>>> plan = plan_from_dict({"axes": {"contact.mu_s": {"from": 0.4, "to": 0.9, "count": 6}, "kappa": [0.7, 1.0]}})
>>> plan.count
12
>>> sweep(plan, "soils").runs                                    # doctest: +SKIP
PosixPath('soils/runs.parquet')
"""

from artibot_sim.sweep.axes import Axis, axis_from_text, known_keys, setting_from_text, unit_of
from artibot_sim.sweep.measures import MEASURES
from artibot_sim.sweep.plan import SweepPlan, load_plan, plan_from_dict
from artibot_sim.sweep.run import SweepOutcome, sweep

__all__ = [
    "MEASURES",
    "Axis",
    "SweepOutcome",
    "SweepPlan",
    "axis_from_text",
    "known_keys",
    "load_plan",
    "plan_from_dict",
    "setting_from_text",
    "sweep",
    "unit_of",
]
