"""The benchmarks, in the order in which they run."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from artibot_sim.bench import model, nodes, peak, peers, trains, workflows
from artibot_sim.bench.model import Scenario
from artibot_sim.bench.results import Result, Skipped
from artibot_sim.errors import ArtibotError


@dataclass(frozen=True)
class Benchmark:
    """One thing to measure.

    Attributes
    ----------
    names : tuple of str
        Of the results it gives.
    run : callable
    seconds : float
        About how long it takes, for the progress bar.
    missing : callable
        Says what keeps it from running here, or None.
    in_quick : bool
        Whether ``--quick`` runs it when it was not asked for by name.
    """

    names: tuple[str, ...]
    run: Callable[[Scenario], list[Result]]
    seconds: float
    missing: Callable[[], str | None] = lambda: None
    in_quick: bool = True


SUITE: dict[str, Benchmark] = {
    "rollout": Benchmark(("rollout_rk4_1ms", "rollout_semi_implicit", "rollout_semi_implicit_2ms"), model.rollouts, 2),
    "uneven": Benchmark(("rollout_rk4_1ms_uneven", "rollout_semi_implicit_uneven"), model.over_uneven_ground, 3),
    "effects": Benchmark(("rollout_rk4_1ms_one_effect", "rollout_rk4_1ms_all_effects"), model.all_effects, 10),
    "modules": Benchmark(
        ("rollout_3_modules", "rollout_5_modules", "rollout_10_modules", "two_modules_own_kernels"), trains.modules, 10,
        in_quick=False,
    ),
    "mujoco_train": Benchmark(
        ("mujoco_train5_difference",), trains.against_mujoco, 20, peers.missing, in_quick=False,
    ),
    "batch": Benchmark(("batch_rk4_all_cores", "batch_rk4_ratio_to_one_core"), model.batch, 15),
    "batch_effects": Benchmark(("batch_rk4_all_effects_all_cores",), workflows.batch_with_effects, 15),
    "sweep": Benchmark(tuple(workflows.WAYS), workflows.sweeps, 15),
    "windows": Benchmark(("windows", "windows_one_effect", "windows_all_effects"), model.windows, 20),
    "peak": Benchmark(
        ("peak_one_core", "peak_all_cores", "peak_fraction_one_core", "peak_fraction_all_cores"), peak.peak, 12,
    ),
    "mujoco": Benchmark(
        ("mujoco_law_rk4_1ms", "mujoco_law_euler_1ms", "mujoco_native_rk4_1ms", "mujoco_native_implicitfast_1ms"),
        peers.mujoco, 15, peers.missing,
    ),
    "mujoco_heightfield": Benchmark(
        ("mujoco_heightfield_height", "mujoco_heightfield_tilt"), peers.mujoco_heightfield, 10, peers.missing,
        in_quick=False,
    ),
    "mujoco_export": Benchmark(
        ("mujoco_export_turns",), peers.mujoco_export, 30, peers.missing, in_quick=False,
    ),
    "pinocchio": Benchmark(("pinocchio_law_rk4_1ms",), peers.pinocchio, 10, peers.no_pinocchio, in_quick=False),
    "drake": Benchmark(("drake_law_rk4_1ms",), peers.drake, 45, peers.no_drake, in_quick=False),
    "pybullet": Benchmark(("pybullet_law_euler_1ms",), peers.pybullet, 10, peers.no_pybullet, in_quick=False),
    "ripple": Benchmark(
        ("back_speed_ripple_rk4_1ms", "back_speed_ripple_semi_implicit_2ms", "back_speed_ripple_converged"),
        model.ripples, 1,
    ),
    "pose": Benchmark(
        tuple(model.pose_name(*step) for step in model.STEPS), model.poses, 3,
    ),
    "start": Benchmark(("start_cold", "start_warm"), model.starts, 40, in_quick=False),
    "identify": Benchmark(("identify_3x45s",), workflows.identify_3x45s, 25, in_quick=False),
    "diagnose": Benchmark(
        ("diagnose_4x45s",), workflows.diagnose_4x45s, 90, workflows.missing, in_quick=False,
    ),
    "recorder": Benchmark(("recorder_writer",), workflows.writer, 3),
    "recorder_node": Benchmark(("recorder_node",), nodes.recorder_node, 40, nodes.missing, in_quick=False),
    "sim": Benchmark(("sim_node_cpu_share", "sim_node_late_p99"), nodes.sim, 26, nodes.missing, in_quick=False),
    "replay": Benchmark(("replay_late_p99",), nodes.replay, 35, nodes.replay_missing, in_quick=False),
    "driver": Benchmark(
        ("driver_late_p99", "driver_sync_jitter_p99", "driver_callback_longest"),
        nodes.driver, 45, nodes.missing, in_quick=False,
    ),
    "chain": Benchmark(("chain_cpu_share",), nodes.chain, 60, nodes.missing, in_quick=False),
    "odometry": Benchmark(("odometry_node_cpu_share",), nodes.odometry, 45, nodes.missing, in_quick=False),
    "view": Benchmark(("view_start", "view_live_cpu_share"), nodes.view, 60, nodes.no_viewer, in_quick=False),
    "replay_can": Benchmark(
        ("replay_can_late_p99",), nodes.replay_can, 40, nodes.replay_missing, in_quick=False,
    ),
}  # fmt: skip
"""Name → :class:`Benchmark`."""


def chosen(only: Sequence[str], quick: bool) -> list[str]:
    """Benchmarks to run: those that are, or give, what was asked for by name; all, or the quick ones, if nothing was.

    Raises
    ------
    ArtibotError
        For a name that is no benchmark's and no result's.
    """
    for name in only:
        if not any(name == key or name in benchmark.names for key, benchmark in SUITE.items()):
            raise ArtibotError(f"bench: nothing is called '{name}'; expected one of {', '.join(all_names())}")
    if not only:
        return [key for key, benchmark in SUITE.items() if benchmark.in_quick or not quick]
    return [key for key, benchmark in SUITE.items() if {key, *benchmark.names} & set(only)]


def all_names() -> list[str]:
    """Names of benchmarks and of their results."""
    return [name for key, benchmark in SUITE.items() for name in dict.fromkeys((key, *benchmark.names))]


def run(keys: Sequence[str], scenario: Scenario, begin: Callable[[str], Any]) -> tuple[list[Result], list[Skipped]]:
    """Run benchmarks; `begin` is called with which one comes next."""
    results: list[Result] = []
    skipped: list[Skipped] = []
    for key in keys:
        begin(key)
        reason = SUITE[key].missing()
        if reason is not None:
            skipped.append(Skipped(key, reason))
            continue
        try:
            results += SUITE[key].run(scenario)
        except ArtibotError as error:  # one that fails does not take the others' numbers with it
            skipped.append(Skipped(key, str(error), failed=True))
    return peers.attach(results), skipped
