"""Distributed study layer: configuration, evaluation, storage, fronts, figures."""

from __future__ import annotations

from typing import Any

from . import metrics  # noqa: F401  (fills the table of metrics)
from .config import ConfigError, Study, load_scene, load_study
from .evaluate import evaluate, evaluate_with_series
from .point import Point, Record

__all__ = [
    "ConfigError",
    "Point",
    "Record",
    "Study",
    "evaluate",
    "evaluate_with_series",
    "load_scene",
    "load_study",
    "open_study",
]


def __getattr__(name: str) -> Any:
    """``open_study`` on first use: it needs xarray's files, which a worker does not."""
    if name == "open_study":
        from .store import open_study

        return open_study
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
