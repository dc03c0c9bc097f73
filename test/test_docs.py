"""What the docs name is there: files and folders of the tree by their paths."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from ros_helpers import ROOT

PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").glob("*.md")])
NAMED = re.compile(r"`([a-z0-9_]+(?:/[a-z0-9_]+)*\.py)`")


def files_of_artibot() -> list[str]:
    """Paths of all Python files below the packages, tests, launch files and the repository's own folder."""
    found = [path for top in ("artibot_sim", "artibot_driver", "test", "launch") for path in (ROOT / top).rglob("*.py")]
    return [f"/{path.relative_to(ROOT).as_posix()}" for path in [*found, *ROOT.glob("*.py")]]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_files_that_a_page_names_exist(page: Path) -> None:
    files = files_of_artibot()
    named = set(NAMED.findall(page.read_text(encoding="utf-8")))
    assert not {name for name in named if not any(path.endswith(f"/{name}") for path in files)}


def test_the_map_is_what_the_tree_says() -> None:
    done = subprocess.run([sys.executable, str(ROOT / "scripts" / "map.py"), "--check"], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_pages_do_name_files() -> None:
    assert sum(len(NAMED.findall(page.read_text(encoding="utf-8"))) for page in PAGES) > 50


def test_comments_name_files_that_exist() -> None:
    files = files_of_artibot()
    missing = []
    for path in files:
        if path.startswith("/artibot_"):
            text = (ROOT / path[1:]).read_text(encoding="utf-8")
            missing += [(path, name) for name in NAMED.findall(text) if not any(f.endswith(f"/{name}") for f in files)]
    assert not missing
