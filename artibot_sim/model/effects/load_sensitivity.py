"""Ground that is stiffer under wheels that carry more."""

from __future__ import annotations

from typing import TYPE_CHECKING

from artibot_sim.model.effects.base import Effect, Search, Values, number
from artibot_sim.model.kernels.compilation import inlined
from artibot_sim.model.kernels.elementary import exp, log

if TYPE_CHECKING:
    from artibot_sim.model.robot.parameters import Params


@inlined
def stiffness_by_load(fx, load):
    """Factor of k_l and k_t of a wheel that carries `load` times the rover's mean."""
    exponent = fx.load_sensitivity.exponent
    carried = load if load > 1e-3 else 1e-3
    return exp(exponent * log(carried)) if exponent != 0.0 else 1.0


def _adapt(p: Params, values: Values) -> Params:
    """How much stiffer the ground is under the module whose wheels carry most, or least."""
    modules = (p.front, p.back)[: 2 if p.two else 1]
    heaviest = max(body.m for body in modules) * len(modules) / sum(body.m for body in modules)
    lightest = min(body.m for body in modules) * len(modules) / sum(body.m for body in modules)
    power = values["exponent"]
    return p._replace(stiffening=p.stiffening * max(heaviest**power, lightest**power))


EFFECT = Effect(
    id="load_sensitivity",
    acts="contact",
    doc="k_l and k_t of each wheel are multiplied by (F_n over the mean load of the rover's wheels)^exponent.",
    parameters={"exponent": number("-", -2.0, 2.0, "0: eq. 15, 1: as for friction")},
    adapt=_adapt,
    hooks={"stiffness_by_load": stiffness_by_load},
    search=Search({"exponent": 0.5}, ((-1.0,), (1.0,), (2.0,))),
)
