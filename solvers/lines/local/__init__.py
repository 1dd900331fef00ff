"""Small motion about the static shape in local coordinates: papers 000 and 002, corrected."""

from .model import LocalModel, build

__all__ = ["LocalModel", "build"]
