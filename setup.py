"""Package of artibot, for colcon (ament_python) and for pip."""

import runpy
import sys
from pathlib import Path
from xml.etree import ElementTree

from setuptools import find_packages, setup

PACKAGE = "artibot_sim"
ROOT = Path(__file__).resolve().parent
MAINTAINER = ElementTree.parse(ROOT / "package.xml").find("maintainer")


def share_files():
    """Files for share/artibot_sim: what ament looks for, and the folders config and launch as they are."""
    share = f"share/{PACKAGE}"
    files = {"share/ament_index/resource_index/packages": [f"resource/{PACKAGE}"], share: ["package.xml"]}
    for path in sorted([*ROOT.glob("config/**/*"), *ROOT.glob("launch/*.launch.py")]):
        if path.is_file():
            inside = path.relative_to(ROOT)
            files.setdefault(f"{share}/{inside.parent}", []).append(str(inside))
    return list(files.items())


def executables():
    """`artibot` everywhere; for ROS also each of its words, which land in lib/artibot_sim.

    colcon and bloom run `setup.py install` or `develop`; pip never does, and a program called `sim` or `plot`
    has no place in a user's PATH.
    """
    words = runpy.run_path(str(ROOT / PACKAGE / "cli" / "words.py"))["COMMANDS"]
    for_ros = {"install", "develop"} & set(sys.argv)
    return ["artibot = artibot_sim.cli:program"] + [f"{word} = artibot_sim.cli:executable" for word in words if for_ros]


setup(
    name=PACKAGE,
    version=runpy.run_path(str(ROOT / PACKAGE / "version.py"))["__version__"],
    description="Simulate, record and replay articulated eight-wheel rovers",
    license="Apache-2.0",
    maintainer=MAINTAINER.text,
    maintainer_email=MAINTAINER.get("email"),
    packages=find_packages(include=[f"{PACKAGE}*", "artibot_driver*"]),
    data_files=share_files(),
    zip_safe=False,
    python_requires=">=3.10",
    install_requires=[
        "canopen>=2.4",
        "click>=8.1",
        "matplotlib>=3.7",
        "mcap>=1.6",
        "numba>=0.59",
        "numpy>=1.26",
        "plotly>=5.20",
        "pyarrow>=15",
        "python-can>=4.3",
        "python-can-remote>=0.3",
        "pyyaml>=6.0",
        "rich>=13.0",
        "rosbags>=0.11",
        "scipy>=1.11",
    ],
    extras_require={
        # ROS 2 Jazzy as wheels (x86-64, Python 3.10-3.13). Never on top of a ROS 2 that is sourced already.
        "ros": ["ros-jazzy-rclpy[fastrtps]", "ros-jazzy-rmw-fastrtps-cpp", "ros-jazzy-common-interfaces"],
        "bench": ["mujoco>=3.2"],
        # Rovers in three dimensions, in the browser: `artibot view`
        "view": ["viser>=1.1"],
        # The regressor that predictions of real recordings are held against
        "real": ["scikit-learn>=1.3"],
        # Diagnoses: how much of the errors is explainable at all, and `--residual`
        "residual": ["scikit-learn>=1.3"],
        # Sweeps, identifications and campaigns on a Dask cluster
        "cluster": ["distributed>=2024.1"],
        "test": [
            "cantools>=39.4",
            "distributed>=2024.1",
            "hypothesis>=6.100",
            "mcap-ros2-support>=0.5",
            "mujoco>=3.2",
            "pytest>=7.4",
            "pytest-xdist>=3.5",
            "scikit-learn>=1.3",
            "sympy>=1.12",
            "viser>=1.1",
        ],
        # Another minor version of ruff formats otherwise, one of mypy finds more: neither may break a clone of today.
        "dev": [
            "colcon-common-extensions>=0.3",
            "mypy==2.4.*",
            "ruff==0.17.*",
            "setuptools>=70.1,<80",
        ],  # as colcon asks
    },
    entry_points={"console_scripts": executables()},
)
