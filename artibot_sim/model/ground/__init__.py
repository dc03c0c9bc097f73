"""Uneven ground: height, stiffness and friction over `map`, from files or drawn at random."""

from artibot_sim.model.ground.files import load_ground, save_ground
from artibot_sim.model.ground.raster import Ground, random_ground

__all__ = ["Ground", "load_ground", "random_ground", "save_ground"]
