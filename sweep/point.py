"""What travels between the study, the workers and the store: an Order or a Point goes out, a Record comes back."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from solvers import Ask, Scene


@dataclass(frozen=True, kw_only=True)
class Point:
    """One design in one environment, ready to run; ``key`` is the hash of its canonical physics inputs."""

    key: str
    design: int
    environment: int
    values: dict[str, float]  # design variables by name
    scene: Scene
    ask: Ask
    settings: Any  # sweep.config.MetricSettings: window, baseline, probe, ...
    problem: str = ""  # why there can be no such scene, which then is the study's; the point is not run


@dataclass(frozen=True, kw_only=True)
class Order:
    """A planned point on its way to where it is run: what a Point is made of, beside the study."""

    key: str
    design: int
    environment: int
    values: dict[str, float]


@dataclass(frozen=True, kw_only=True)
class Record:
    """The row of a point: always there, whatever happened to the run. Plain data, JSON-safe."""

    key: str
    design: int
    environment: int
    values: dict[str, float]
    status: str  # solvers.Status name, or CRASHED, TIMEOUT, MEMORY, ERROR, IMPOSSIBLE, BASELINE_FAILED
    message: str = ""
    metrics: dict[str, float] = field(default_factory=dict)  # NaN (JSON null) where the run failed
    energy_residual: float = float("nan")
    nodes_per_wave: float = float("nan")
    steps_per_period: float = float("nan")
    harmonics: int = 0  # of harmonic balance
    multiplier: float = float("nan")  # size of the largest Floquet multiplier
    steps: int = 0
    evaluations: int = 0
    seconds: float = 0.0
    first_seconds: float = 0.0  # cost of a first, untrusted attempt that was retried; 0 without a retry
    model: str = ""
    method: str = ""
    segments: int = 0
    tolerance: float = float("nan")

    @property
    def trusted(self) -> bool:
        return self.status == "OK"

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)
