"""How fine must a run be? Mesh and tolerance from pilot runs whose differences estimate the error.

The error is that of the transverse response: rms over all nodes and times of the displacement from the static state,
normal to the static tangent, relative to the same rms of the response (at rest: of the shape, from its chord).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from .model import Response, Status

STILL = 1e-10  # of the length: a displacement that is rounding
STATIONS = 40  # equal parts of the line at whose ends two runs are compared
SAFETY = 1.25  # on an error that is extrapolated from coarser meshes
LEFT = 0.25  # of the accuracy asked that the mesh may take whatever time stepping and kinematics do
NEARLY = 0.8  # of what time stepping may take, aimed at by interpolation
GROWTH, LEAST_GROWTH = 3.0, 1.3  # by which one pilot's mesh exceeds the last one's
LEAST = 8  # segments
GUARDED = 3  # finer meshes, by 1.4 each, that are tried where one is right but the line's guards call it UNRESOLVED
COARSER = (1.6, 1.35, 1.15, 1.0)  # by which meshes are coarser that the chosen run judges
GAIN = 0.8  # of the chosen run's work: what those may take
JUDGE, JUDGES = 0.4, 2  # of the accuracy asked: where its error is above, so many finer meshes are tried as judges
FINER = 1.5  # times as fine each
STAGES = 6  # evaluations in an explicit step
FINEST, MOST_WORK = 20_000, 1e10  # segments, and counted operations of all pilots (minutes)
TIGHTEST = 1e-10  # tolerance
CHAOTIC, WILD = 0.3, 4  # runs that differ by more at so many tolerances in a row have nothing in common
ENDED = frozenset({Status.OK, Status.UNRESOLVED, Status.COARSE_STEP, Status.ENERGY_OPEN, Status.FEW_HARMONICS})


def motion_at(run: Response, stations: np.ndarray, tangent: np.ndarray | None = None) -> np.ndarray:
    """Displacement at arc lengths (ns,) [m], by cubic splines between the nodes: (nt, ns, 3) [m].

    In motion from the static state and normal to `tangent` (ns, 3), by default the run's own static one; at rest
    from the chord.
    """
    s = run.signals
    x = s["position"]
    if len(run.t) == 1:
        share = ((s["arc"] - s["arc"][0]) / (s["arc"][-1] - s["arc"][0]))[:, None]
        x = x - ((1 - share) * x[:, :1] + share * x[:, -1:])
        return np.asarray(CubicSpline(s["arc"], x, axis=1)(stations))
    field = np.asarray(CubicSpline(s["arc"], x - s["static_position"], axis=1)(stations))
    t = tangents(run, stations) if tangent is None else tangent
    return field - np.einsum("tna,na->tn", field, t)[:, :, None] * t


def tangents(run: Response, stations: np.ndarray) -> np.ndarray:
    """Unit tangents of the static shape at arc lengths (ns,): (ns, 3)."""
    s = run.signals
    t = np.asarray(CubicSpline(s["arc"], s["static_position"], axis=0)(stations, 1))
    return t / np.linalg.norm(t, axis=1)[:, None]


def stations_of(length: float) -> np.ndarray:
    """Arc lengths at which runs are compared [m]."""
    return np.linspace(0.0, length, STATIONS + 1)[1:-1]


def gap(run: Response, truth: Response) -> float:
    """Relative rms difference of the transverse response; infinite where either has none to compare."""
    if run.status not in ENDED or truth.status not in ENDED or len(run.t) != len(truth.t) or not len(run.t):
        return math.inf
    stations = stations_of(float(truth.signals["arc"][-1]))
    tangent = tangents(truth, stations) if len(run.t) > 1 else None
    a, b = motion_at(run, stations, tangent), motion_at(truth, stations, tangent)
    difference, size = float(np.sum((a - b) ** 2)), float(np.sum(b**2))
    rounding = b.size * (STILL * float(truth.signals["arc"][-1])) ** 2
    if size <= rounding:  # a straight line at rest
        return 0.0 if difference <= rounding else math.inf
    return math.sqrt(difference / size)


def free(segments: int) -> float:
    """Steps that an implicit method must take."""
    return 0.0


class Way(NamedTuple):
    """A line and a method that could do it."""

    model: str
    method: str
    order: float  # of the line in the segment's length, where the response is smooth
    price: float  # of one evaluation at one node, that of the lumped line being 1
    knob: float  # first tolerance, or the fixed step [s]; NaN for neither
    factor: float  # by which the knob is made finer to estimate the error in time
    tune: bool  # whether the knob may be changed
    given: float = 0.0  # estimated error of the line's kinematics
    late_order: float = 4.0  # of the method in the step
    least_steps: Callable[[int], float] = free  # that stability asks for on a mesh


Attempt = Callable[[Way, int, float], Response]  # (way, segments, knob)


class Offer(NamedTuple):
    """What a way would cost on the mesh that it seems to need."""

    work: float
    way: Way
    knob: float
    late: float  # estimated error in time


class Refined(NamedTuple):
    """What pilots found."""

    way: Way
    segments: int
    knob: float
    response: Response  # of that way, mesh and knob
    error: float  # estimated, of the response; NaN where waveforms do not converge
    late: float  # its part from time stepping
    order: float  # seen, of the mesh
    runs: int  # pilots, the last one included
    work: int  # counted, of all of them
    chaotic: bool


class Pilots:
    """Runs made so far, and their counted work."""

    def __init__(self, attempt: Attempt) -> None:
        self._attempt = attempt
        self._made: dict[tuple[str, str, int, float], Response] = {}
        self.work = 0.0

    def __call__(self, way: Way, segments: int, knob: float) -> Response:
        key = (way.model, way.method, segments, knob)
        if key not in self._made:
            self._made[key] = self._attempt(way, segments, knob)
            self.work += work(way, self._made[key])
        return self._made[key]

    def __len__(self) -> int:
        return len(self._made)


def share_of(way: Way) -> float:
    """Of the accuracy asked what time stepping may take: steps times segments are fewest where both errors, each times
    its order, are equal."""
    return way.order / (way.order + way.late_order)


def operations(run: Response) -> int:
    """Counted: evaluations, a factorisation like four of them, times nodes."""
    return (run.cost.evaluations + 4 * run.cost.factorisations) * (run.segments + 1)


def work(way: Way, run: Response) -> float:
    """Operations times price."""
    return way.price * operations(run)


def in_time(pilots: Pilots, way: Way, segments: int, wanted: float) -> tuple[float, float]:
    """Largest tolerance (or the step as given) whose time error is at most `wanted`, and that error.

    A run is compared with one whose knob is `factor` times finer, the error being taken proportional to the knob.
    Infinite where finer runs do not come closer: a chaotic response.
    """
    knob, wild = way.knob, 0
    if math.isnan(knob):
        return knob, 0.0
    while True:
        run = pilots(way, segments, knob)
        if run.status == Status.CANNOT_REPRESENT:
            return knob, math.inf
        found = gap(run, pilots(way, segments, knob / way.factor)) / (1 - 1 / way.factor)
        good = found <= wanted and run.status != Status.ENERGY_OPEN
        if good or not way.tune or knob / way.factor**2 < TIGHTEST:
            return knob, found
        wild = wild + 1 if found > CHAOTIC else 0
        if wild == WILD:
            return knob, math.inf
        if found > wanted:  # not so where the ledger is open
            between, late = in_between(pilots, way, segments, knob, wanted / found)
            if late <= wanted:
                return between, late
        knob /= way.factor


def in_between(pilots: Pilots, way: Way, segments: int, knob: float, share: float) -> tuple[float, float]:
    """A tolerance at which a run errs by `share` of what it errs at `knob`, and its error beside the run at `knob` over
    `factor`; infinite where that is no coarser."""
    fine, between = knob / way.factor, NEARLY * knob * share
    if not 1.5 * fine < between < knob:
        return fine, math.inf
    run = pilots(way, segments, between)
    if run.status == Status.ENERGY_OPEN:
        return fine, math.inf
    return between, gap(run, pilots(way, segments, fine)) / (1 - fine / between)


def projected(pilots: Pilots, way: Way, first: int, knob: float, segments: float) -> float:
    """Work of a way on another mesh: steps grow as from the first pilot's mesh to the second, or as stability asks."""
    one, two = pilots(way, first, knob), pilots(way, 2 * first, knob)
    steps = max(one.cost.steps, 1)
    growth = max(two.cost.steps / steps, 1.0)
    ratio = max(segments / first, 0.5)
    grown = max(ratio ** math.log2(growth), way.least_steps(math.ceil(segments)) / steps)
    return work(way, one) * ratio * grown


def refine(attempt: Attempt, ways: list[Way], accuracy: float, first: int) -> Refined:
    """The way that pilots promise to be cheapest, on the coarsest mesh and at the loosest tolerance whose estimated
    errors add up to less than `accuracy`.

    Parameters
    ----------
    ways : at least one; the first is taken where the response is chaotic
    first : segments of the first pilot, of a line of order 2
    """
    pilots = Pilots(attempt)
    offers: list[Offer] = []
    given = first
    for way in sorted(ways, key=lambda way: way.least_steps(given)):
        first = first_of(way, given)
        floor = way.price * STAGES * way.least_steps(first) * (first + 1)
        if offers and floor > 5 * min(offer.work for offer in offers):
            continue  # too dear to try
        knob, late = in_time(pilots, way, first, share_of(way) * accuracy)
        if not late <= CHAOTIC:
            continue
        apart = gap(pilots(way, first, knob), pilots(way, 2 * first, knob))
        error = SAFETY * apart * 2**way.order / (2**way.order - 1)
        share = (error / wanted_in_space(way, accuracy, late)) ** (1 / way.order)
        mesh = max(LEAST, first * min(100.0, share))
        offers.append(Offer(projected(pilots, way, first, knob, mesh), way, knob, late))
    if not offers:
        way = ways[0]
        first = first_of(way, given)
        run = pilots(way, first, way.knob)
        return Refined(way, first, way.knob, run, math.nan, math.inf, way.order, len(pilots), round(pilots.work), True)
    found = []
    for _, way, knob, late in sorted(offers, key=lambda offer: offer.work):
        fine, error, p = in_space(pilots, way, first_of(way, given), knob, wanted_in_space(way, accuracy, late))
        run = pilots(way, fine, knob)
        for k in range(1, GUARDED + 1):  # a layer at a clamp, a short wave
            finer = math.ceil(fine * 1.4**k)
            if run.status != Status.UNRESOLVED or finer > FINEST or pilots.work > MOST_WORK:
                break
            other = pilots(way, finer, knob)
            if other.status == Status.OK:
                fine, run = finer, other
        while run.status == Status.ENERGY_OPEN and way.tune and knob / way.factor > TIGHTEST:
            knob /= way.factor  # finer meshes ring more
            run = pilots(way, fine, knob)
        total = error + late + way.given
        found.append(Refined(way, fine, knob, run, total, late, p, len(pilots), round(pilots.work), False))
        if run.status == Status.OK:
            break
    best = next((one for one in found if one.response.status in ENDED), found[0])
    if best.response.status == Status.OK:
        best = sure(pilots, best, accuracy)
    if best.response.status == Status.OK and best.error < accuracy and pilots.work <= MOST_WORK:
        best = thrifty(pilots, offers, best, accuracy, given)
    return best._replace(runs=len(pilots), work=round(pilots.work))


def sure(pilots: Pilots, best: Refined, accuracy: float) -> Refined:
    """The chosen run with its error in time measured on its own mesh, where modes ring that the first one had not; at a
    finer tolerance where that is too much."""
    way = best.way
    while way.tune and best.knob / way.factor >= TIGHTEST and pilots.work <= MOST_WORK:
        finer = pilots(way, best.segments, best.knob / way.factor)
        late = gap(best.response, finer) / (1 - 1 / way.factor)
        error = best.error - best.late + late
        if error <= accuracy or late <= share_of(way) * accuracy or finer.status != Status.OK:
            return best._replace(error=error, late=late)
        best = best._replace(knob=best.knob / way.factor, response=finer, error=error, late=late)
    return best


class Page(NamedTuple):
    """What a cheaper run might be: a way at a knob, beside the chosen one's."""

    each: float  # work per node, on the first pilot's mesh
    way: Way
    knob: float
    late: float  # estimated error in time


def pages_of(pilots: Pilots, offers: list[Offer], best: Refined, given: int) -> list[Page]:
    """Ways of the chosen line at the tolerances that pilots tried, from the cheapest on; what they cost on a coarse
    mesh must leave hope."""
    found = []
    for offer in (offer for offer in offers if offer.way.model == best.way.model):
        way, first = offer.way, first_of(offer.way, given)
        for knob in {offer.knob, *((way.knob, way.knob / way.factor) if way.tune else ())}:
            each = work(way, pilots(way, first, knob)) / (first + 1)
            if not knob >= offer.knob or each * best.segments / COARSER[0] > GAIN * work(best.way, best.response):
                continue
            late = offer.late
            if knob > offer.knob:
                finer = pilots(way, first, knob / way.factor)
                late = gap(pilots(way, first, knob), finer) / (1 - 1 / way.factor)
            found.append(Page(each, way, knob, late))
    return sorted(found, key=lambda page: page.each)


def judged(pilots: Pilots, best: Refined, accuracy: float) -> tuple[Response, float]:
    """The run beside which cheaper ones are held, and its estimated error: the chosen one, or one on a finer mesh."""
    judge, error = best.response, best.error
    rest = best.late + best.way.given
    for _ in range(JUDGES):
        finer = math.ceil(FINER * judge.segments)
        if error <= JUDGE * accuracy or finer > FINEST or pilots.work > MOST_WORK:
            break
        other = pilots(best.way, finer, best.knob)
        if other.status != Status.OK:
            break
        less = (finer / judge.segments) ** best.order
        told = SAFETY * gap(judge, other) / (less - 1)
        judge, error = other, rest + max(told, 0.5 * (error - rest) / less)  # two meshes may agree by accident
    return judge, error


def thrifty(pilots: Pilots, offers: list[Offer], best: Refined, accuracy: float, given: int) -> Refined:
    """The least work among runs of the same line, on coarser meshes and at looser tolerances, that differ from a finer
    run by no more than what its estimated error leaves of `accuracy`; `best` where there is none.

    Estimates are on the safe side, most of all where contact makes the errors of coarse meshes uneven; beside a run
    that is better than need be cheaper ones need no estimate.
    """
    pages = pages_of(pilots, offers, best, given)
    if not pages:
        return best
    most, chosen = GAIN * work(best.way, best.response), best.segments
    judge, error = judged(pilots, best, accuracy)
    for page in (page for page in pages if page.late <= accuracy - error):
        for ratio in COARSER:
            mesh = math.ceil(chosen / ratio)
            if mesh < LEAST or page.each * (mesh + 1) > most:
                break
            run = pilots(page.way, mesh, page.knob)
            if run.status == Status.ENERGY_OPEN or work(page.way, run) > most:
                break
            if run.status != Status.OK:
                continue
            apart = gap(run, judge)
            if apart <= accuracy - error:
                most = GAIN * work(page.way, run)
                best = best._replace(
                    way=page.way, segments=mesh, knob=page.knob, response=run, error=error + apart, late=page.late)
                break
    return best


def first_of(way: Way, given: int) -> int:
    """Segments of a way's first pilot: elements of order 4 do with half as many."""
    return given if way.order <= 2 else max(LEAST, given // 2)


def wanted_in_space(way: Way, accuracy: float, late: float) -> float:
    """What the line's kinematics and time stepping leave to the mesh."""
    return max(accuracy - late - way.given, LEFT * accuracy)


def in_space(pilots: Pilots, way: Way, first: int, knob: float, wanted: float) -> tuple[int, float, float]:
    """The coarsest mesh whose estimated error is at most `wanted`, that error, and the order seen."""
    meshes, apart, p = [first, 2 * first], [gap(pilots(way, first, knob), pilots(way, 2 * first, knob))], way.order
    while True:
        coarse, fine = meshes[-2:]
        if len(apart) > 1:
            p = order_seen(meshes[-3:], apart[-2:], way.order)
        error = SAFETY * apart[-1] / ((fine / coarse) ** p - 1)
        usable = apart[-1] < 1.0
        if usable and error <= wanted and fine >= 1.6 * coarse:  # two meshes may agree by accident: ask a third
            middle = round(math.sqrt(fine * coarse))
            other = gap(pilots(way, middle, knob), pilots(way, fine, knob))
            error = max(error, SAFETY * other / ((fine / middle) ** p - 1))
        good = usable and error <= wanted
        if good or fine >= FINEST or pilots(way, fine, knob).status not in ENDED or pilots.work > MOST_WORK:
            break
        growth = min(GROWTH, max(LEAST_GROWTH, 1.05 * (error / wanted) ** (1 / p))) if usable else 2.0
        meshes.append(min(FINEST, math.ceil(fine * growth)))
        apart.append(gap(pilots(way, fine, knob), pilots(way, meshes[-1], knob)))
    coarser = math.ceil(1.1 * fine * (error / wanted) ** (1 / p)) if usable else fine
    if LEAST <= coarser <= 0.75 * fine:  # finer than need be
        between = SAFETY * gap(pilots(way, coarser, knob), pilots(way, fine, knob)) + error
        if between <= wanted:
            return coarser, between, p
    return fine, error, p


def order_seen(meshes: list[int], apart: list[float], order: float) -> float:
    """Order p at which an error C N^-p gives the differences of three meshes, from 0.5 to that of the line."""
    a, b, c = meshes

    def excess(p: float) -> float:
        return (a**-p - b**-p) / (b**-p - c**-p) - apart[0] / apart[1]

    if not (0 < apart[1] < math.inf and apart[0] < math.inf) or excess(order) <= 0:
        return order
    return 0.5 if excess(0.5) >= 0 else float(brentq(excess, 0.5, order))
