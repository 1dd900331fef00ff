"""Lumped-mass line, planar or spatial, with devices: paper 003 section 2, corrected."""

from .model import LumpedModel, build

__all__ = ["LumpedModel", "build"]
