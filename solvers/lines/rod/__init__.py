"""Rod, catenary and hybrid of both: paper 001, corrected."""

from .model import RodModel, build_catenary, build_rod
from .params import bending_layers

__all__ = ["RodModel", "bending_layers", "build_catenary", "build_rod"]
