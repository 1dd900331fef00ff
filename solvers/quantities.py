"""Every output of a run, once: name, unit, dimensions, meaning. Labels and file attributes read this table."""

from __future__ import annotations

from typing import NamedTuple


class Quantity(NamedTuple):
    """A named signal of a Response."""

    unit: str
    dims: tuple[str, ...]
    meaning: str


QUANTITIES: dict[str, Quantity] = {
    "arc": Quantity("m", ("node",), "unstretched arc length of the cable's nodes from end A"),
    "static_position": Quantity("m", ("node", "axis"), "position in the static state"),
    "static_tangent": Quantity("1", ("node", "axis"), "unit tangent in the static state, along increasing s"),
    "span_mass": Quantity("kg", ("segment",), "mass of the plain cable in each segment, rods as cable"),
    "rigid": Quantity("1", ("segment",), "1 where the segment is a rigid rod"),
    "position": Quantity("m", ("time", "node", "axis"), "position of the cable's nodes"),
    "velocity": Quantity("m/s", ("time", "node", "axis"), "velocity of the cable's nodes"),
    "tension": Quantity("N", ("time", "segment"), "axial force of each segment, damping included"),
    "curvature": Quantity("1/m", ("time", "node"), "curvature at each node"),
    "force": Quantity("N", ("time", "node", "axis"), "internal force on the side towards end B"),
    "moment": Quantity("N m", ("time", "node", "axis"), "internal moment on the side towards end B"),
    "shear": Quantity("N", ("time", "node"), "internal force across the cable"),
    "torque": Quantity("N m", ("time", "node"), "internal moment about the cable"),
    "twist": Quantity("rad/m", ("time", "node"), "rate of turn of the cable's frame about its axis"),
    "domain": Quantity("1", ("time", "segment"), "1 where the segment is a rod, 0 where it is a catenary"),
    "end_force": Quantity("N", ("time", "end", "axis"), "external force on ends A and B, end half-segment included"),
    "stroke": Quantity("m", ("time", "device"), "offset of each device's mass from mid-stroke"),
    "kinetic": Quantity("J", ("time",), "kinetic energy of cable, devices and added mass"),
    "strain": Quantity("J", ("time",), "strain energy above the static state"),
    "gravity": Quantity("J", ("time",), "potential of weight, buoyancy and steady end forces above the static state"),
    "work": Quantity("J", ("time",), "work put in at the moved ends since t = 0"),
    "lost_water": Quantity("J", ("time",), "energy lost to drag since t = 0"),
    "lost_cable": Quantity("J", ("time",), "energy lost to the cable's internal damping since t = 0"),
    "lost_device": Quantity("J", ("time",), "energy lost in the devices' dampers since t = 0"),
    "lost_seabed": Quantity("J", ("time",), "energy lost to seabed damping and friction since t = 0"),
    "rotation": Quantity("J", ("time",), "energy booked: turning added mass and slide directions, steady moments"),
}
