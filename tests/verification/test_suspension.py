"""The study of the hanging wire, from its YAML to its row, against elasticas and catenaries solved independently."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from sweep.config import load_study
from sweep.evaluate import evaluate
from sweep.space import points

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests" / "analytic"))
from elastica import hybrid_suspension, suspension  # noqa: E402

STUDY = load_study(ROOT / "configs" / "suspension.yaml")
PAPER = {point.values["joint"]: point for point in points(STUDY) if point.environment == 0}


@pytest.mark.parametrize("joint", [0.0, 0.5, 1.5])
def test_a_row_is_the_elastica(joint):
    """160 elements of second order: 1e-5 of the length, 1e-3 of the moment at the guided end."""
    found, reference = evaluate(PAPER[joint]), hybrid_suspension(joint) if joint else suspension()
    assert found.status == "OK", found.message
    # the catenary's error is in the mesh of its own, of (0.0125 m / 0.57 m)^2 / 12
    assert found.metrics["sag"] == pytest.approx(reference.lowest()[1], abs=2e-5)
    assert found.metrics["end_moment_top"] == pytest.approx(abs(reference.moment[-1]), rel=1e-3)
    assert found.metrics["peak_tension_bottom"] == pytest.approx(reference.tension[0], rel=1e-5)
    assert found.metrics["least_tension_top"] == pytest.approx(0.0, abs=1e-8)
    assert found.metrics["rod_share"] == pytest.approx(1 - joint / 2)
    whole = suspension()
    s = np.linspace(0, 2, 2001)
    gap = np.hypot(*(np.interp(s, reference.s, getattr(reference, k)) - getattr(whole, k) for k in "xz")).max()
    assert found.metrics["shape_error"] == pytest.approx(gap, abs=2e-4)
