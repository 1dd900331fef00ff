"""Lines whose highest frequency is known in closed form, one for each kind that may limit an explicit step."""

from __future__ import annotations

import math

from solvers import BNES, End, Scene, Section, Water

N, L = 20, 10.0


def taut(tension: float, kind: str = "pinned", devices: tuple = (), wet: bool = False, **section) -> Scene:
    """A weightless vertical line without drag."""
    given = {"length": L, "d": 0.05, "mass": 2.0, "EA": 1e5, "wet_weight": 0.0, "Can": 0.0, "Cdn": 0.0}
    cable = Section(**{**given, **section})
    held = {"direction": (0, 0, 1)} if kind == "clamped" else {}
    return Scene(
        cable=(cable,), end_a=End(kind=kind, position=(0, 0, 0), **held), devices=devices,
        end_b=End(kind=kind, position=(0, 0, L * (1 + tension / cable.EA)), **held),
        water=Water(density=1000.0) if wet else None,
    )  # fmt: skip


TOP = math.sin((N - 1) * math.pi / (2 * N))  # of the highest mode between two held ends
h = L / N
SLIDER = BNES(s=5.0, mass=1.0, EA=1e6, phi0=10.0, law="springs")
LINES = {
    # (scene, highest frequency): the closed forms of the lattice
    "axial": (taut(100.0), 2 / h * math.sqrt(1e5 / 2.0) * TOP),
    # tangential added mass slows the axial waves below the transverse ones
    "tension": (
        taut(1e3, wet=True, Cat=1000.0),
        2 / h * math.sqrt(1e3 / 2.0) * TOP / math.sqrt(1.01),
    ),
    "bending": (taut(0.0, EI=1e5, compression=True), 4 / h**2 * math.sqrt(1e5 / 2.0) * TOP**2),
    # at its wall: sqrt(2 k (1/M + 1/m_h)) sin(phi0), the host being light and loose
    "device": (
        taut(100.0, EA=1e3, devices=(SLIDER,)),
        math.sqrt(2 * 2e6 * (1 / 1.0 + 1 / (2.0 * h))) * math.sin(math.radians(10.0)),
    ),
}
