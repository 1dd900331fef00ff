"""Small transverse motion of a nearly straight cable, with devices: one coordinate, cubic splines."""

from .model import TransverseModel, build

__all__ = ["TransverseModel", "build"]
