"""Rod, catenary and hybrid of both: paper 001, corrected."""

from .model import RodModel, build_catenary, build_rod

__all__ = ["RodModel", "build_catenary", "build_rod"]
