"""Cubic Hermite elements in a vertical plane: position and slope at every node, large motion."""

from .model import HermiteModel, build

__all__ = ["HermiteModel", "build"]
