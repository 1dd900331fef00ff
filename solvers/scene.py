"""The vocabulary of a scene: cable, ends, motion, water, seabed, devices, start. Frozen, validated, SI.

x and y are horizontal, z is up, z = 0 is the still water level. Arc length s runs from end A (the lower or
anchored end) to end B (the upper or driven one). Every class is a frozen pydantic dataclass: it validates from
YAML, from a notebook and on ``dataclasses.replace``, and a mistake is a ``pydantic.ValidationError`` that lists
every field at fault.
"""

from __future__ import annotations

import math
from dataclasses import field
from itertools import pairwise
from typing import Annotated, Any, Literal, TypeVar, Union, dataclass_transform

from pydantic import BeforeValidator, ConfigDict, Field, model_validator
from pydantic.dataclasses import dataclass


def _no_bool(value: Any) -> Any:
    if isinstance(value, bool):
        raise ValueError("a number is wanted here, not true or false")
    return value


Number = Annotated[float, BeforeValidator(_no_bool), Field(allow_inf_nan=False)]
Positive = Annotated[float, BeforeValidator(_no_bool), Field(gt=0, allow_inf_nan=False)]
NonNegative = Annotated[float, BeforeValidator(_no_bool), Field(ge=0, allow_inf_nan=False)]
Vector = tuple[Number, Number, Number]


_T = TypeVar("_T")


@dataclass_transform(kw_only_default=True, frozen_default=True, field_specifiers=(Field, field))
def record(cls: type[_T]) -> type[_T]:
    """A frozen, keyword-only, strict dataclass: unknown fields and NaN are refused."""
    strict = dataclass(frozen=True, kw_only=True, config=ConfigDict(extra="forbid"))
    return strict(cls)  # type: ignore[return-value]


# --------------------------------------------------------------------------------------------- cable


@record
class Section:
    """One stretch of cable with constant properties.

    Give either ``mass`` with the outer volume it displaces (``volume``, by default that of ``d``), or ``mass``
    with ``wet_weight``. ``compression`` says whether the section carries compression: a power cable does, chain
    and wire rope do not; by default it does when ``EI > 0`` (paper 003, eq. 2.1.3, corrected).
    """

    length: Positive  # unstretched length [m]
    d: Positive  # outer diameter [m]: displaced volume, added mass
    mass: Positive  # mass in air [kg/m]
    EA: Positive  # axial stiffness [N]
    EI: NonNegative = 0.0  # bending stiffness [N m2]
    BA: NonNegative = 0.0  # axial damping: tension per strain rate [N s]
    BI: NonNegative = 0.0  # bending damping: moment per curvature rate [N m2 s]
    compression: bool | None = None
    volume: NonNegative | None = None  # displaced volume [m3/m]
    wet_weight: Number | None = None  # weight less buoyancy [N/m]; negative floats
    drag_diameter: Positive | None = None  # [m], default d
    Can: NonNegative = 1.0  # normal added-mass coefficient
    Cat: NonNegative = 0.0  # tangential added-mass coefficient
    Cdn: NonNegative = 1.2  # normal drag coefficient
    Cdt: NonNegative = 0.0  # tangential drag coefficient, on the wetted perimeter pi d
    # what only a line with rotations can follow; body axes are 1, 2 across and 3 along the cable
    EI2: Positive | None = None  # bending stiffness about body axis 2, default EI (which is then about axis 1) [N m2]
    GJ: Positive | None = None  # torsional stiffness, default EI/1.3: a round solid of Poisson's ratio 0.3 [N m2]
    coupling: Number = 0.0  # tension per twist rate and torque per strain of a laid rope [N m]
    curvature: Vector = (0.0, 0.0, 0.0)  # intrinsic curvature about body axes 1, 2 and twist rate [1/m]
    moment: Vector = (0.0, 0.0, 0.0)  # distributed moment in space [N m/m]
    inertia: tuple[NonNegative, NonNegative, NonNegative] | None = None  # rotary, about body axes; default solid [kg m]

    @model_validator(mode="after")
    def _one_weight(self) -> Section:
        wrong = []
        if self.volume is not None and self.wet_weight is not None:
            wrong.append("give `volume` or `wet_weight`, not both")
        if self.coupling**2 >= self.EA * (self.torsion or 1e300):
            wrong.append("`coupling` squared must be below EA GJ, or stretching would release energy")
        if self.EI == 0 and (self.EI2 or self.GJ or self.coupling or any(self.curvature)):
            wrong.append("`EI2`, `GJ`, `coupling` and `curvature` need an `EI` above 0")
        if wrong:
            raise ValueError("; ".join(wrong))
        return self

    @property
    def torsion(self) -> float:
        """Torsional stiffness GJ, 0 for a section that does not bend [N m2]."""
        return self.EI / 1.3 if self.GJ is None else self.GJ

    @property
    def carries_compression(self) -> bool:
        return self.EI > 0 if self.compression is None else self.compression

    def wet(self, density: float, g: float) -> float:
        """Weight less buoyancy in a fluid of `density` [kg/m3]; [N/m]."""
        if self.wet_weight is not None:
            return self.wet_weight
        volume = math.pi / 4 * self.d**2 if self.volume is None else self.volume
        return (self.mass - density * volume) * g


# --------------------------------------------------------------------------------------------- motion


@record
class Harmonic:
    """One term ``amplitude * sin(2 pi frequency t + phase)`` of an end's displacement."""

    amplitude: Vector  # [m]
    frequency: Positive  # [Hz]
    phase: Number = 0.0  # [rad]


@record
class Window:
    """Where a motion acts. Ramps of zero length are jumps, like eq. (3.4) of paper 003.

    ``shape`` of the ramps: ``cosine`` is (1 - cos(pi x))/2, ``smooth`` the quintic with continuous acceleration.
    """

    start: Number = 0.0  # [s]
    stop: Number | None = None  # [s]; None never stops
    ramp_up: NonNegative = 0.0  # [s]
    ramp_down: NonNegative = 0.0  # [s]
    shape: Literal["cosine", "smooth"] = "cosine"

    @model_validator(mode="after")
    def _ordered(self) -> Window:
        if self.stop is not None and self.stop - self.start < self.ramp_up + self.ramp_down:
            raise ValueError("`stop - start` must be at least `ramp_up + ramp_down`")
        return self


@record
class Table:
    """A displacement sampled at increasing times, interpolated by a C2 cubic spline; constant outside."""

    t: tuple[Number, ...] = Field(min_length=4)  # [s]
    x: tuple[Vector, ...] = Field(min_length=4)  # [m]

    @model_validator(mode="after")
    def _matching(self) -> Table:
        if len(self.t) != len(self.x):
            raise ValueError(f"`t` has {len(self.t)} entries, `x` has {len(self.x)}")
        if any(b <= a for a, b in pairwise(self.t)):
            raise ValueError("`t` must increase")
        return self


@record
class Stochastic:
    """Paper 003 section 4, corrected: harmonics with random amplitude, frequency and phase, and noise.

    Term j has amplitude N(A, spread A), frequency N(f_j, spread f_j) about ``frequency * multiples[j]`` and phase
    U(0, 2 pi). The noise is Gaussian, of standard deviation ``noise_level``, drawn each ``noise_interval`` and
    joined by a cubic spline, so that it is band-limited and has a velocity. Same seed, same motion.
    """

    amplitude: Vector  # [m]
    frequency: Positive  # [Hz]
    seed: Annotated[int, Field(ge=0)]
    multiples: tuple[Positive, ...] = (1.0, 2.0, 4.0)
    amplitude_spread: NonNegative = 0.1
    frequency_spread: NonNegative = 0.05
    noise_level: NonNegative = 0.0  # [m]
    noise_interval: Positive = 0.05  # [s]


@record
class Motion:
    """Prescribed displacement of an end from its position: (harmonics + random terms) x window + table."""

    harmonics: tuple[Harmonic, ...] = ()
    stochastic: Stochastic | None = None
    window: Window | None = None
    table: Table | None = None

    @model_validator(mode="after")
    def _something(self) -> Motion:
        if not self.harmonics and self.table is None and self.stochastic is None:
            raise ValueError("a motion needs `harmonics`, `stochastic` or `table`")
        if self.stochastic is not None and (self.window is None or self.window.stop is None):
            raise ValueError("`stochastic` needs a `window` with a `stop`: random phases jump at its edges")
        return self


# --------------------------------------------------------------------------------------------- ends, start


@record
class Turn:
    """An angle sampled at increasing times, interpolated by a C2 cubic spline; constant outside."""

    t: tuple[Number, ...] = Field(min_length=4)  # [s]
    angle: tuple[Number, ...] = Field(min_length=4)  # [deg]

    @model_validator(mode="after")
    def _matching(self) -> Turn:
        if len(self.t) != len(self.angle):
            raise ValueError(f"`t` has {len(self.t)} entries, `angle` has {len(self.angle)}")
        if any(b <= a for a, b in pairwise(self.t)):
            raise ValueError("`t` must increase")
        return self


@record
class End:
    """An end of the cable: ``free``, ``pinned`` (moment free) or ``clamped`` along ``direction``.

    A free end may carry a steady ``force``; with a ``direction`` it is guided: free to move, not to turn.
    ``direction`` points the way s increases and need not be a unit vector. ``motion`` moves a pinned or clamped end.
    A free end's ``position`` is where a *released* start holds it. A ``moment`` acts on an end that may turn;
    ``twist`` turns an end that may not about its direction. At twist 0 the end's body axis 2 is horizontal (along y
    where the direction is vertical).
    """

    kind: Literal["free", "pinned", "clamped"]
    position: Vector | None = None  # [m]
    direction: Vector | None = None
    force: Vector | None = None  # [N]
    moment: Vector | None = None  # steady, in space [N m]
    twist: Number | Turn = 0.0  # [deg]
    motion: Motion | None = None

    @property
    def turns(self) -> bool:
        """Whether the end is free to turn."""
        return self.direction is None

    @model_validator(mode="after")
    def _consistent(self) -> End:
        wrong = []
        if self.kind != "free" and self.position is None:
            wrong.append(f"a {self.kind} end needs a `position`")
        if self.kind != "free" and self.force is not None:
            wrong.append("only a free end takes a `force`")
        if self.kind == "free" and self.motion is not None:
            wrong.append("a free end cannot have a `motion`")
        if self.kind == "clamped" and self.direction is None:
            wrong.append("a clamped end needs a `direction`")
        if self.kind == "pinned" and self.direction is not None:
            wrong.append("a pinned end has no `direction`: `clamped` holds it, `free` with a `direction` guides it")
        if self.direction is not None and self.moment is not None:
            wrong.append("a `moment` on an end that cannot turn does nothing")
        if self.direction is None and self.twist != 0.0:
            wrong.append("`twist` needs a `direction` to turn about")
        if self.direction is not None and math.hypot(*self.direction) == 0:
            wrong.append("`direction` must not be zero")
        if wrong:
            raise ValueError("; ".join(wrong))
        return self


@record
class Start:
    """The state at t = 0.

    ``static``: equilibrium under the steady loads. ``released``: equilibrium with free ends held at their
    positions, then let go. ``given``: the polyline ``shape`` (spread evenly over the arc length, or at the arc
    lengths ``s``) and ``velocity`` (one vector, or one for each point of ``shape``).
    """

    kind: Literal["static", "released", "given"] = "static"
    shape: tuple[Vector, ...] | None = None  # [m]
    s: tuple[NonNegative, ...] | None = None  # [m]
    velocity: tuple[Vector, ...] | None = None  # [m/s]

    @model_validator(mode="after")
    def _consistent(self) -> Start:
        if (self.kind == "given") != (self.shape is not None):
            raise ValueError("`shape` belongs to a start of kind `given`, which needs it")
        n = len(self.shape or ())
        if self.kind == "given" and n < 2:
            raise ValueError("`shape` needs at least two points")
        if self.s is not None and (len(self.s) != n or any(b <= a for a, b in pairwise(self.s))):
            raise ValueError("`s` must increase and have one entry for each point of `shape`")
        if self.velocity is not None and len(self.velocity) not in (1, n):
            raise ValueError("`velocity` has one vector, or one for each point of `shape`")
        return self


# --------------------------------------------------------------------------------------------- surroundings


@record
class Current:
    """A steady current, linear between the levels z and constant outside them."""

    z: tuple[Number, ...] = Field(min_length=1)  # [m], increasing
    velocity: tuple[Vector, ...] = Field(min_length=1)  # [m/s]

    @model_validator(mode="after")
    def _matching(self) -> Current:
        if len(self.z) != len(self.velocity):
            raise ValueError(f"`z` has {len(self.z)} entries, `velocity` has {len(self.velocity)}")
        if any(b <= a for a, b in pairwise(self.z)):
            raise ValueError("`z` must increase")
        return self


@record
class Water:
    """The sea; a cable in this project is always fully wet. Leave `water` out of the scene for air."""

    density: Positive = 1025.0  # [kg/m3]
    depth: Positive | None = None  # [m]
    current: Current | None = None


@record
class Seabed:
    """A flat bed: normal force d l (stiffness depth + damping rate), never pulling; friction smoothed near rest."""

    z: Number  # level of the bed [m]
    stiffness: Positive = 3e6  # [Pa/m]
    damping: NonNegative = 0.0  # [Pa s/m]
    friction: NonNegative = 0.0  # coefficient
    friction_speed: Positive = 0.01  # friction is mu N v / sqrt(v2 + friction_speed2) [m/s]


# --------------------------------------------------------------------------------------------- devices


@record
class _Body:
    """What every device has. ``s`` is the arc length of its centre from end A."""

    s: NonNegative  # [m]
    mass: Positive  # [kg]
    volume: NonNegative | None = None  # displaced volume [m3]; default mass/density: neutrally buoyant
    drag: NonNegative = 0.0  # drag coefficient times area [m2]
    added_mass: NonNegative = 0.0  # [kg]
    rod: Positive | Literal["cords"] | None = None  # length of the rigid inline rod [m]; None: mounted at a point
    rod_EA: Positive | None = None  # axial stiffness of the rod [N]; default that of the cable it replaces

    @property
    def rod_length(self) -> float:
        """Length of the rod, 0 when there is none [m]."""
        return float(self.rod or 0.0)

    @model_validator(mode="after")
    def _rod_without_cords(self) -> _Body:
        if self.rod == "cords" and not hasattr(self, "half_span"):
            raise ValueError("`rod: cords` is the distance between a bnes device's cord ends; give a length here")
        return self


@record
class PointMass(_Body):
    """A mass or buoy fixed to the cable. ``kind: locked`` is a device whose mass has been locked."""

    kind: Literal["mass", "buoy", "locked"] = "mass"


@record
class BNES(_Body):
    """A bistable nonlinear energy sink: a mass between two inclined cords, paper 003 eqs. (2.2.1)-(2.2.3).

    ``kind: bnes`` slides across the cable only; ``bnes_free`` is a free particle held by two tension-only cords.
    Natural length l0, half-span a = l0 cos(phi0), rest offset y0 = l0 sin(phi0), cord stiffness k = EA/l0 and
    damper c = BA/l0. ``rod: cords`` is a rod of 2 a, from cord end to cord end. ``law: cords`` resist in tension
    only, ``springs`` both ways.
    """

    kind: Literal["bnes", "bnes_free"] = "bnes"
    EA: Positive  # cord axial stiffness [N]
    BA: NonNegative = 0.0  # cord axial damping [N s]
    length: Positive = 0.5  # natural length of a cord l0 [m]
    phi0: Annotated[float, BeforeValidator(_no_bool), Field(ge=0, lt=90)] = 3.562  # [deg]
    law: Literal["cords", "springs"] = "cords"
    side: Literal[1, -1] = 1  # starts at +y0 or -y0
    direction: Vector | None = None  # slide direction; default in the plane of the scene, across the cable

    @model_validator(mode="after")
    def _free_has_cords(self) -> BNES:
        if self.kind == "bnes_free" and self.law != "cords":
            raise ValueError("a free device is held by `cords`")
        return self

    @property
    def rod_length(self) -> float:
        return 2 * self.half_span if self.rod == "cords" else float(self.rod or 0.0)

    @property
    def half_span(self) -> float:
        return self.length * math.cos(math.radians(self.phi0))

    @property
    def rest_offset(self) -> float:
        return self.length * math.sin(math.radians(self.phi0))


@record
class CubicNES(_Body):
    """A NES without bistability (phi0 = 0): F = 2 k (1 - a/sqrt(a2 + y2)) y, cubic for small y."""

    kind: Literal["nes"] = "nes"
    EA: Positive  # [N]
    BA: NonNegative = 0.0  # [N s]
    length: Positive = 0.5  # [m]
    direction: Vector | None = None


@record
class TMD(_Body):
    """A linear tuned mass damper that slides across the cable."""

    kind: Literal["tmd"] = "tmd"
    k: Positive  # [N/m]
    c: NonNegative = 0.0  # [N s/m]
    direction: Vector | None = None


Device = Annotated[Union[PointMass, BNES, CubicNES, TMD], Field(discriminator="kind")]  # noqa: UP007


# --------------------------------------------------------------------------------------------- scene


@record
class Scene:
    """A cable in its surroundings, ready to be modelled."""

    cable: tuple[Section, ...] = Field(min_length=1)
    end_a: End
    end_b: End
    water: Water | None = None
    seabed: Seabed | None = None
    devices: tuple[Device, ...] = ()
    start: Start = field(default_factory=Start)
    g: NonNegative = 9.80665
    name: str = ""

    @property
    def length(self) -> float:
        """Unstretched length of the whole cable [m]."""
        return sum(section.length for section in self.cable)

    @property
    def density(self) -> float:
        return self.water.density if self.water else 0.0

    @model_validator(mode="after")
    def _devices_fit(self) -> Scene:
        wrong = []
        spans = []
        for i, device in enumerate(self.devices):
            half = device.rod_length / 2
            if not half <= device.s <= self.length - half:
                wrong.append(f"devices[{i}]: s = {device.s:g} m with its rod is off the cable (0 to {self.length:g} m)")
            if half > 0 and not half < device.s < self.length - half:
                wrong.append(f"devices[{i}]: a rod must leave cable between itself and the end")
            spans.append((device.s - half, device.s + half, i))
        spans.sort()
        for (_, stop, i), (start, _, j) in pairwise(spans):
            if start <= stop:
                wrong.append(f"devices[{i}] and devices[{j}] are at the same place: their mounts must not touch")
        if self.end_a.kind == "free" and self.end_b.kind == "free" and self.start.kind == "static":
            wrong.append("a cable with two free ends has no static start: use a `given` or `released` start")
        if self.start.kind == "released" and any(
            end.kind == "free" and end.position is None for end in (self.end_a, self.end_b)
        ):
            wrong.append("a released start needs the `position` where the free end is held")
        if self.seabed and self.water and self.water.depth and abs(self.seabed.z + self.water.depth) > 1e-9:
            wrong.append("`seabed.z` must be minus `water.depth`")
        if wrong:
            raise ValueError("; ".join(wrong))
        return self
