#!/usr/bin/env python3
"""Do the tests notice when a place that decides is wrong? Each mutant below is one wrong line in a copy of the tree.

    python scripts/mutants.py [WORD …]     # only mutants with one of the words in their name

Prints for every mutant whether its tests fail, as they should; exits with 1 where one survives.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


@dataclass(frozen=True)
class Mutant:
    """One wrong line.

    Attributes
    ----------
    name : str
        What is wrong with it.
    file : str
        From the root.
    right, wrong : str
        The text as it is, found once in the file, and what stands there instead.
    tests : tuple of str
        Arguments of pytest, from `test`: the tests that guard the place.
    """

    name: str
    file: str
    right: str
    wrong: str
    tests: tuple[str, ...]


MUTANTS = (
    Mutant(
        "sliding wheels are held by mu_s (eq. 16)", "artibot_sim/model/equations/contact.py",
        "held = mu_d * F_n / math.sqrt(F_h2)", "held = mu_s * F_n / math.sqrt(F_h2)",
        ("model/test_fast_equals_plain.py", "model/test_contact_forces.py"),
    ),
    Mutant(
        "back torques share without the front's part (eq. 30)", "artibot_sim/model/equations/transmission.py",
        "(1.0 / share - 1.0)", "(1.0 / share)",
        ("sharing", "model/test_fast_equals_plain.py"),
    ),
    Mutant(
        "semi-implicit steps are never cut", "artibot_sim/model/analysis/stability.py",
        "return max(1, math.ceil(count - 1e-9))", "return 1",
        ("model/test_stability.py",),
    ),
    Mutant(
        "windows' starts are not eliminated from the normal equations", "artibot_sim/estimation/solver.py",
        "matrices = sums[:, :p, :p] - B.transpose(0, 2, 1) @ solved[:, :, :-1]", "matrices = sums[:, :p, :p]",
        ("estimation/test_solver.py",),
    ),
    Mutant(
        "spread between the nodes of a profile is left out of intervals", "artibot_sim/estimation/uncertainty.py",
        ' + np.einsum("k,ki,kj->ij", weight, away, away)', "",
        ("estimation/test_uncertainty.py",),
    ),
    Mutant(
        "an early stream is called a late one", "artibot_sim/estimation/streams.py",
        "coarse = np.arange(-most, most + 1e-9, _COARSE)", "coarse = np.arange(0.0, most + 1e-9, _COARSE)",
        ("estimation/test_streams.py", "estimation/test_checks.py"),
    ),
    Mutant(
        "the threshold ignores --false-alarms", "artibot_sim/diagnose/policy.py",
        "return self.floor + self.tail * max(0.0, float(-np.log(false_alarm_rate * prior_odds)))", "return self.floor",
        ("diagnose/test_policy.py",),
    ),
    Mutant(
        "effects are named where a force on no list explains it", "artibot_sim/diagnose/verdict.py",
        '"force": ("yes", "beside")}, Outcome.UNEXPLAINED)', '"force": ("yes", "beside")}, Outcome.NAMED)',
        ("diagnose/test_verdict.py",),
    ),
    Mutant(
        "names stay though held-out recordings speak against them", "artibot_sim/diagnose/verdict.py",
        'Row({"held out": ("worse",)}, Outcome.UNEXPLAINED, Reason.REFUTED),\n        Row({"held out": ("little",)',
        'Row({"held out": ("little",)',
        ("diagnose/test_verdict.py", "diagnose/test_refuted.py"),
    ),
    Mutant(
        "what sensitivities promise is not fitted", "artibot_sim/diagnose/selection/joint_fits.py",
        "[: rounds.most_expected]", "[:0]",
        ("diagnose/test_seeds.py::test_a_seed_is_answered[soil_softening-212777215]",),
    ),
    Mutant(
        "a recording's soil is sought from the compromise alone", "artibot_sim/diagnose/selection/per_recording.py",
        "if len(poor) < len(fits):", "if len(poor) < 0:",
        ("diagnose/test_seeds.py::test_a_seed_is_answered[other_ground-4021737138]",),
    ),
    Mutant(
        "no recording by itself ever leaves more than noise", "artibot_sim/diagnose/selection/per_recording.py",
        "return not self.unexplained_alone", "return True",
        ("diagnose/test_seeds.py::test_a_seed_is_answered[joint_friction-42]",),
    ),
    Mutant(
        "a silent drive is no reason to stop", "artibot_driver/master/monitoring.py",
        "if silence > config.drive_timeout:", "if silence > 1e9:",
        ("driver/test_faults.py", "driver/test_master_phases.py", "driver/test_master_cycle.py"),
    ),
    Mutant(
        "quick stop is read as operation enabled", "artibot_driver/cia402.py",
        "QUICK_STOP_ACTIVE = Pattern(0x6F, 0x07)", "QUICK_STOP_ACTIVE = Pattern(0x6F, 0x26)",
        ("driver/test_cia402.py",),
    ),
    Mutant(
        "a pose's heading leaps at half a turn", "artibot_sim/experiment/reader.py",
        "yaw[rows] = np.unwrap(yaw[rows])", "yaw[rows] = yaw[rows]",
        ("experiment/test_reader.py", "experiment/test_rollout_bag.py"),
    ),
)  # fmt: skip


def main(words: list[str]) -> int:
    """Try the chosen mutants one after the other; 1 where one survives."""
    chosen = [mutant for mutant in MUTANTS if not words or any(word in mutant.name for word in words)]
    survivors = 0
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        copy = Path(folder) / "artibot"
        listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
        for name in listed.splitlines():
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, copy / name)
        for mutant in chosen:
            start = time.monotonic()
            killed = tried(mutant, copy)
            survivors += not killed
            print(
                f"{'killed' if killed else 'SURVIVES':9} {time.monotonic() - start:5.0f} s  {mutant.name}", flush=True
            )
    print(f"{len(chosen) - survivors} of {len(chosen)} killed")
    return 1 if survivors else 0


def tried(mutant: Mutant, copy: Path) -> bool:
    """Whether the mutant's tests fail in `copy`, which is as before afterwards."""
    path = copy / mutant.file
    text = path.read_text()
    if text.count(mutant.right) != 1:
        raise SystemExit(f"{mutant.file}: found {text.count(mutant.right)} times, expected once: {mutant.right}")
    path.write_text(text.replace(mutant.right, mutant.wrong))
    environment = {**os.environ, "PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1", "OPENBLAS_NUM_THREADS": "1"}
    environment["ARTIBOT_CACHE_DIR"] = str(copy.parent / "cache")  # compiled code of another mutant must not be met
    shutil.rmtree(copy.parent / "cache", ignore_errors=True)
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider"]
    try:
        run = subprocess.run(
            [*command, *(f"test/{one}" for one in mutant.tests)], cwd=copy, env=environment, capture_output=True
        )
    finally:
        path.write_text(text)
    if run.returncode not in (0, 1):  # a usage error or an import error is no test that fails
        raise SystemExit(f"{mutant.name}: pytest ended with {run.returncode}\n{run.stdout.decode()[-2000:]}")
    return run.returncode == 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
