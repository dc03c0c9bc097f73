"""Shipped files are found from a checkout and from an install, and a wrong name lists the right ones."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from artibot_sim.errors import ArtibotError
from artibot_sim.resources import KINDS, config_folder, config_names, config_path, local_environment
from ros_helpers import ROOT

PROFILES = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")
"""Variables in which Fast DDS looks for its profile, of this and of older versions."""


def test_in_a_checkout_the_files_are_those_of_config() -> None:
    assert config_folder() == ROOT / "config"
    assert config_path("robots", "agriq") == ROOT / "config" / "agriq.yaml"
    assert config_path("manoeuvres", "table6_agriq") == ROOT / "config" / "manoeuvres" / "table6_agriq.yaml"


def test_each_file_is_of_one_kind() -> None:
    assert {"agriq", "epiq", "husky"} <= set(config_names("robots"))
    assert not set(config_names("robots")) & set(config_names("nodes"))
    top = {path.stem for path in (ROOT / "config").glob("*.yaml")}
    assert top == set(config_names("robots")) | set(config_names("nodes"))


@pytest.mark.parametrize("kind", KINDS)
def test_a_wrong_name_lists_the_right_ones(kind: str) -> None:
    with pytest.raises(ArtibotError, match=rf"{kind}: there is no 'nonsense'; expected one of .*") as caught:
        config_path(kind, "nonsense")
    for name in config_names(kind):
        assert name in str(caught.value)


def test_a_wrong_kind_is_refused() -> None:
    with pytest.raises(ArtibotError, match="'recipes': unknown; expected one of robots, nodes"):
        config_names("recipes")


def copied(folder: Path) -> Path:
    """Copy the two modules that resources.py needs below `folder`, as an installer would."""
    package = folder / "artibot_sim"
    package.mkdir(parents=True)
    for name in ("__init__.py", "errors.py", "resources.py"):
        shutil.copy(ROOT / "artibot_sim" / name, package)
    return package


def found_from(folder: Path) -> subprocess.CompletedProcess[str]:
    """Ask a copy of the package, alone on the path, where its files are."""
    code = (
        f"import sys; sys.path.insert(0, {str(folder)!r}); import artibot_sim.resources as r; print(r.config_folder())"
    )
    return subprocess.run([sys.executable, "-I", "-c", code], cwd=folder, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("site", ["lib/python3.12/site-packages", "local/lib/python3.12/dist-packages", "."])
def test_an_install_finds_its_share(tmp_path: Path, site: str) -> None:
    copied(tmp_path / site)
    share = (tmp_path / "local" if site.startswith("local") else tmp_path) / "share" / "artibot_sim" / "config"
    share.mkdir(parents=True)
    assert found_from(tmp_path / site).stdout.strip() == str(share)


def test_a_package_without_its_files_says_so(tmp_path: Path) -> None:
    copied(tmp_path)
    done = found_from(tmp_path)
    assert done.returncode != 0
    assert (
        f"{tmp_path}/artibot_sim: found neither config/ beside package.xml nor share/artibot_sim/config" in done.stderr
    )


def test_nodes_that_keep_to_this_machine_speak_over_loopback_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("RMW_IMPLEMENTATION", *PROFILES):
        monkeypatch.delenv(name, raising=False)
    found = local_environment()
    assert {found[name] for name in PROFILES} == {str(ROOT / "config" / "fastdds.xml")}
    for name, value in found.items():
        monkeypatch.setenv(name, value)
    assert local_environment() == found, "what it set itself is no profile of somebody else"


@pytest.mark.parametrize("other", [("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp"), *((p, "/mine.xml") for p in PROFILES)])
def test_another_middleware_or_profile_stays_and_the_range_is_the_machine(
    monkeypatch: pytest.MonkeyPatch, other: tuple[str, str]
) -> None:
    monkeypatch.setenv(*other)
    assert local_environment() == {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
