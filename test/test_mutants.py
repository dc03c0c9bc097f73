"""What `scripts/mutants.py` makes wrong still stands in the tree: a renamed line would end it half-way."""

from __future__ import annotations

import importlib.util
import sys

from ros_helpers import ROOT


def test_every_mutant_finds_its_line_once_and_its_tests() -> None:
    spec = importlib.util.spec_from_file_location("mutants", ROOT / "scripts" / "mutants.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["mutants"] = module
    spec.loader.exec_module(module)
    for mutant in module.MUTANTS:
        assert (ROOT / mutant.file).read_text().count(mutant.right) == 1, mutant.name
        assert all((ROOT / "test" / path.partition("::")[0]).exists() for path in mutant.tests), mutant.name
