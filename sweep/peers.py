"""Other programs on the same scene: MoorDyn (lumped masses, explicit) and CableDyn (Hermite elements, implicit).

Decks are written from the scene; a scene that a program cannot follow has a reason (:func:`unable`). What is timed is
their step calls alone, without reading the deck, finding the start or fetching positions, so that what favour there is
goes to them. Neither keeps an energy ledger: their runs are finite, or they are not, and no more is known.
"""

from __future__ import annotations

import contextlib
import importlib.util
import math
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from solvers import Ask, Feature, Response, Scene, Status
from solvers.catalogue import needs
from solvers.motion import held, motion_pack

PEERS = ("MoorDyn", "CableDyn")
METHODS = {"MoorDyn": "RK4", "CableDyn": "generalised-alpha"}
SAFE = 0.9  # share of Runge-Kutta's stable step that MoorDyn is given
STUB = 0.5  # length of the fixed rod that holds a clamped end [m]
DEPTH = 100.0  # of a bottom far below the line [m]
SAGGING = 1e-3  # a line longer than its chord by more than its stretch and this share hangs
RELAXED, RELAXING = 1e-7, 200.0  # MoorDyn's own relaxation of a line that hangs and bends: threshold, longest [s]
NOTHING = (0.0, 0.0, 0.0)


class PeerFailed(RuntimeError):
    """A run that did not stay finite, or a program that refused the deck."""


def installed() -> list[str]:
    """Programs that can be imported here."""
    return [name for name in PEERS if importlib.util.find_spec(name.lower()) is not None]


def unable(scene: Scene, ask: Ask, program: str) -> str:
    """Why a program cannot run a scene as it stands here; "" where it can."""
    wanted, cable = needs(scene, ask), scene.cable[0]
    density = scene.density
    buoyant = scene.water is not None or math.isclose(cable.wet(density, scene.g), cable.mass * scene.g, rel_tol=1e-9)
    clamps = [end for end in (scene.end_a, scene.end_b) if end.kind == "clamped"]
    reasons = (
        ("a static run has no cost to compare", ask.duration <= 0),
        (f"devices: {program} has free masses on cords, ours slide across the cable", bool(scene.devices)),
        ("several sections", len(scene.cable) > 1),
        ("a seabed: the programs' contacts differ", scene.seabed is not None),
        ("a current, which it reads from a file of its own", bool(wanted & Feature.CURRENT)),
        ("rotations and torsion", bool(wanted & (Feature.ROTATION | Feature.TORSION))),
        ("bending damping `BI`", cable.BI > 0),
        ("a start that is not static", scene.start.kind != "static"),
        ("a free end", any(end.kind not in ("pinned", "clamped") for end in (scene.end_a, scene.end_b))),
        ("end A moves", scene.end_a.motion is not None),
        ("a weight in no water other than that of the mass", not buoyant),
        ("a wet weight above the weight in air", density > 0 and not volume_of(scene) > 0),
        ("it wants gravity", program == "CableDyn" and scene.g <= 0),
        ("clamps need bending stiffness", bool(clamps) and cable.EI == 0),
    )
    return next((words for words, so in reasons if so), "")


def volume_of(scene: Scene) -> float:
    """Displaced volume that gives the cable its wet weight [m3/m]."""
    cable = scene.cable[0]
    if scene.density == 0:
        return math.pi / 4 * cable.d**2
    return (cable.mass - cable.wet(scene.density, scene.g) / scene.g) / scene.density


class LineType(NamedTuple):
    """A section as both programs want it: one diameter for volume, added mass and drag."""

    d: float  # that of the displaced volume [m]
    mass: float  # [kg/m]
    EA: float
    BA: float
    EI: float
    Cdn: float  # coefficients scaled, so that forces are the scene's
    Can: float
    Cdt: float
    Cat: float


def line_type(scene: Scene) -> LineType:
    """The scene's section, with its coefficients referred to the diameter of the displaced volume."""
    cable = scene.cable[0]
    d = math.sqrt(4 * volume_of(scene) / math.pi)
    wide, drag = (cable.d / d) ** 2, (cable.drag_diameter or cable.d) / d
    return LineType(
        d, cable.mass, cable.EA, cable.BA, cable.EI, drag * cable.Cdn, wide * cable.Can, drag * cable.Cdt,
        wide * cable.Cat,
    )  # fmt: skip


class Path3:
    """The motion of end B at any time."""

    def __init__(self, scene: Scene) -> None:
        self._pack = motion_pack([scene.end_b], np.eye(3))
        self.home = np.array(scene.end_b.position, dtype=float)

    def __call__(self, t: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Position, velocity, acceleration [m, m/s, m/s2]."""
        x, v, a = held(t, 0, self._pack, NOTHING)
        return np.array(x), np.array(v), np.array(a)


def hangs(scene: Scene) -> bool:
    """Whether the line is longer than its chord, so that its start is a catenary."""
    a, b = (np.array(end.position, dtype=float) for end in (scene.end_a, scene.end_b))
    chord = float(np.linalg.norm(b - a))
    return scene.length > (1 + SAGGING) * chord


def along(end: Any) -> np.ndarray:
    """Direction of a clamp, in which s increases."""
    u = np.array(end.direction, dtype=float)
    return np.asarray(u / np.linalg.norm(u))


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Both programs talk while they read a deck and when they fail: silence both streams, below Python."""
    sys.stdout.flush()
    sys.stderr.flush()
    kept = os.dup(1), os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        for stream, old in zip((1, 2), kept, strict=True):
            os.dup2(old, stream)
            os.close(old)
        os.close(nowhere)


def step_of(scene: Scene, segments: int, interval: float) -> float:
    """MoorDyn's step: below RK4's limits for damped axial waves and for bending, whole in an output interval [s]."""
    cable, size = scene.cable[0], scene.length / segments
    omega = 2 / size * math.sqrt(cable.EA / cable.mass)
    zeta = cable.BA * omega / (2 * cable.EA)
    fastest = omega * (zeta + math.sqrt(max(zeta**2 - 1, 0.0)))
    limit = 2.785 / max(fastest, omega)
    if cable.EI > 0:
        inertia = cable.mass + scene.density * math.pi / 4 * cable.d**2 * cable.Can
        limit = min(limit, 2.785 * size**2 / 4 * math.sqrt(inertia / cable.EI))
    return interval / math.ceil(interval / (SAFE * limit))


def run(program: str, scene: Scene, ask: Ask, segments: int, step: float) -> tuple[Response, float]:
    """A run of another program on the output grid of `ask`, and the processor seconds of its step calls.

    Parameters
    ----------
    step : of the program [s]; a whole number of them make an output interval

    Raises
    ------
    PeerFailed
        Where it refuses the deck or does not stay finite.
    """
    per = round(ask.interval / step)
    if per < 1 or not math.isclose(per * step, ask.interval, rel_tol=1e-6):
        raise ValueError(f"step {step:g} s does not divide the output interval {ask.interval:g} s")
    go = {"MoorDyn": _moordyn, "CableDyn": _cabledyn}[program]
    with tempfile.TemporaryDirectory() as folder, quiet():
        try:
            x, seconds = go(scene, round(ask.duration / ask.interval), segments, step, per, Path(folder))
        except PeerFailed:
            raise
        except Exception as error:  # what its library raises
            raise PeerFailed(f"{program}: {error}") from error
    t = np.arange(len(x)) * ask.interval
    first = int(np.searchsorted(t, ask.output_from - 1e-9))
    signals = {"position": x[first:], "static_position": x[0], "arc": np.linspace(0.0, scene.length, segments + 1)}
    found = Response(
        status=Status.OK, t=t[first:], signals=signals, model=program, method=METHODS[program], segments=segments,
    )  # fmt: skip
    return found, seconds


# --------------------------------------------------------------------------- MoorDyn


def moordyn_deck(scene: Scene, segments: int, step: float) -> str:
    """A MoorDyn v2 deck. A clamped end is a fixed rod of finite length (rods of zero length are pins), at end B one on
    a coupled body."""
    a, b = np.array(scene.end_a.position), np.array(scene.end_b.position)
    kind = line_type(scene)
    rods: list[str] = []
    points: list[str] = []
    ends: list[str] = []
    if scene.end_a.kind == "clamped":
        foot = a - STUB * along(scene.end_a)
        rods.append(f"{len(rods) + 1} stub Fixed {_row(a)} {_row(foot)} 1 -")
        ends.append(f"R{len(rods)}A")
    else:
        points.append(f"{len(points) + 1} Fixed {_row(a)} 0 0 0 0")
        ends.append(str(len(points)))
    bodies = []
    if scene.end_b.kind == "clamped":
        bodies.append(f"1 Coupled {_row(b)} 0 0 0 1 0 1 0 0 0")
        rods.append(f"{len(rods) + 1} stub Body1 {_row(STUB * along(scene.end_b))} 0 0 0 1 -")
        ends.append(f"R{len(rods)}B")
    else:
        points.append(f"{len(points) + 1} Coupled {_row(b)} 0 0 0 0")
        ends.append(str(len(points)))
    relax = RELAXING if hangs(scene) and kind.EI > 0 else 0.0
    depth = float(DEPTH - min(0.0, a[2], b[2]) + scene.length)
    sections = {
        "LINE TYPES": ["cable " + " ".join(map(repr, (
            kind.d, kind.mass, kind.EA, kind.BA, kind.EI, kind.Cdn, kind.Can, kind.Cdt, kind.Cat)))],
        "ROD TYPES": [f"stub {kind.d!r} {kind.mass!r} 0 0 0 0"] if rods else [], "BODIES": bodies, "RODS": rods,
        "POINTS": points, "LINES": [f"1 cable {ends[0]} {ends[1]} {scene.length!r} {segments} -"],
    }  # fmt: skip
    text = ["a cable between two ends"]
    for name, rows in sections.items():
        text += [f"---------------------- {name} ----------------------", "names", "units", *rows] if rows else []
    text += [
        "---------------------- OPTIONS ----------------------", "0 writeLog", f"{step * (1 + 1e-6):.9g} dtM",
        "1e4 CFL", "rk4 tScheme", f"{scene.g} g", f"{scene.density} rho", f"{depth} WtrDpth", f"{relax} TmaxIC",
        f"{RELAXED} threshIC", "1 disableOutput", "1 disableOutTime", "------- need this line -------",
    ]  # fmt: skip
    return "\n".join(text) + "\n"


def _row(x: np.ndarray) -> str:
    return " ".join(f"{value:.12g}" for value in x)


def _moordyn(
    scene: Scene, count: int, segments: int, step: float, per: int, folder: Path
) -> tuple[np.ndarray, float]:
    """Positions (nt, n, 3) [m] and seconds. MoorDyn holds the velocity of a moved end for a coupling step, which is
    its own step here, and is given the mean velocity of the step: then the displacement is right at the end of each."""
    import moordyn

    path = Path3(scene)
    moved = np.array([path(k * step)[0] for k in range(count * per + 1)])
    speed = np.diff(moved, axis=0) / step
    turning = [0.0] * 3 if scene.end_b.kind == "clamped" else []
    rows, seconds = np.zeros((count + 1, segments + 1, 3)), 0.0
    deck = folder / "deck.txt"
    deck.write_text(moordyn_deck(scene, segments, step))
    system = moordyn.Create(str(deck))
    if not system:
        raise PeerFailed("MoorDyn refused the deck")
    try:
        start = moordyn.Init if hangs(scene) and scene.cable[0].EI > 0 else moordyn.Init_NoIC
        start(system, [*path.home, *turning], [0.0] * (3 + len(turning)))
        line, at, size = moordyn.GetLine(system, 1), 0, 10 * scene.length + float(np.abs(path.home).max())
        for k in range(count + 1):
            rows[k] = [moordyn.GetLineNodePos(line, i) for i in range(segments + 1)]
            if not np.abs(rows[k]).max() < size:
                raise PeerFailed("MoorDyn did not stay finite")
            begun = time.process_time()
            for _ in range(per if k < count else 0):
                moordyn.Step(system, [*moved[at], *turning], [*speed[at], *turning], at * step, step)
                at += 1
            seconds += time.process_time() - begun
    finally:
        moordyn.Close(system)
    return rows, seconds


# --------------------------------------------------------------------------- CableDyn


def _cabledyn(
    scene: Scene, count: int, segments: int, step: float, per: int, folder: Path
) -> tuple[np.ndarray, float]:
    """Positions (nt, n, 3) [m] and seconds; end A of its line is our end B. It finds its own static start."""
    import cabledyn
    from cabledyn.model import CableDyn

    kind, path = line_type(scene), Path3(scene)
    foot, top = np.array(scene.end_a.position, dtype=float), path.home
    deck = cabledyn.DeckModel.new(title="cable")
    deck.add_line_type(
        "cable", diam=kind.d, mass=kind.mass, ea=kind.EA, ba=kind.BA, ei=kind.EI, cdn=kind.Cdn, cdt=kind.Cdt,
        can=kind.Can, cat=kind.Cat,
    )  # fmt: skip
    deck.add_point(1, "Coupled", *map(float, top))
    deck.add_point(2, "Fixed", *map(float, foot))
    deck.add_line(1, 1, 2, "cable", length=scene.length, num_segs=segments)
    for name, end in (("A", scene.end_b), ("B", scene.end_a)):
        if end.kind == "clamped":
            deck.add_end_connection(1, name, "Rigid", tuple(map(float, -along(end))))
    depth = float(DEPTH - min(0.0, foot[2], top[2]) + scene.length)
    for key, value in (
        ("dtM", step), ("TMax", count * per * step), ("g", scene.g), ("rhoW", scene.density), ("WtrDpth", depth),
    ):  # fmt: skip
        deck.options.set(key, value)
    place = folder / "deck.dat"
    deck.save(place)
    rows, seconds = np.zeros((count + 1, segments + 1, 3)), 0.0
    model = CableDyn(place)
    try:
        line, rest = model.line(1), np.zeros(3)
        asked = model.coupled_layout()[: model.n_coupled_dof // 3]  # lines without bending ask for held ends too
        still = [kind == "fixed" for _, kind in asked]
        rows[0] = _nodes(line)
        for k in range(count):
            for j in range(per):
                moved = path((k * per + j + 1) * step)
                x, v, w = (np.concatenate([b if held else a for held in still]) for a, b in zip(
                    moved, (foot, rest, rest), strict=True))  # fmt: skip
                begun = time.process_time()
                model.step(step, x, v, w)
                seconds += time.process_time() - begun
            rows[k + 1] = _nodes(line)
            if not np.isfinite(rows[k + 1]).all():
                raise PeerFailed("CableDyn did not stay finite")
    finally:
        model.close()
    return rows, seconds


def _nodes(line: Any) -> np.ndarray:
    return np.array(line.node_positions()[::-1])
