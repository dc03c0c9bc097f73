"""Whether a fit's rover did what its soil can be known from."""

from __future__ import annotations

from collections.abc import Iterator

from artibot_sim.estimation.problem import Problem
from artibot_sim.estimation.solver import Point
from artibot_sim.identify.judgement import motion_of


def excitation(problem: Problem, point: Point) -> Iterator[str]:
    """A sentence where no wheel ever slides in a fit."""
    torques = any(s.channel.startswith("torque") for stretch in problem.stretches for s in stretch.series)
    motion = motion_of(problem, point.coordinates, point.starts, torques)
    if motion.sliding == 0.0:
        yield (
            f"no wheel ever slides (at most {motion.grip:.2f} of its load are held): mu_s, mu_d and what acts "
            "through them cannot be told; drive tighter turns"
        )
