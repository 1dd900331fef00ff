"""The front of a study, looked for: an algorithm asks for designs, the common evaluator answers, the store keeps all.

The search is a function of the seed and of the rows: each generation of designs is what the algorithm (its random
state seeded by the study) asks for after the rows of those before. So nothing has to be saved of the algorithm. A
resumed run asks again from the beginning, is answered from the store, checks that the designs are those of
``plan.json``, and comes to the generation in which it was cut off in the state, bit for bit, that it had there. Only
complete generations are told to the algorithm; the last one may be cut by the number of evaluations.

No value is made up for a run that failed or is not trusted: the algorithm is never told of it. It is no parent, takes
no place in a population, dominates nothing; its design is not asked for again. A trusted run that breaks a constraint
is told with the amounts by which it does, and comes behind all that break none. Designs that cannot be built, that
break a bound on a quantity of the design, or that are the same physics as one before, are refused as they are born and
others are made in their place: they cost no run.

``optimise.json`` holds versions, budget and reference point; ``hypervolume.nc`` the volume that the front dominates,
generation by generation.
"""

from __future__ import annotations

import importlib.metadata
import json
import logging
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import xarray as xr
import yaml
from pymoo.algorithms.moo.nsga2 import NSGA2, binary_tournament
from pymoo.algorithms.moo.nsga3 import NSGA3, comp_by_cv_then_random
from pymoo.core.duplicate import DuplicateElimination
from pymoo.core.mixed import MixedVariableMating
from pymoo.core.population import Population
from pymoo.core.problem import Problem
from pymoo.core.sampling import Sampling
from pymoo.core.termination import NoTermination
from pymoo.core.variable import Choice, Integer, Real
from pymoo.indicators.hv import HV
from pymoo.operators.selection.tournament import TournamentSelection
from pymoo.util.nds.non_dominated_sorting import NonDominatedSorting
from pymoo.util.ref_dirs import get_reference_directions
from scipy.stats import qmc

from . import distribute, locks, pareto
from .config import DESIGN_QUANTITIES, ConfigError, Study, Variable
from .dataset import assemble
from .mistakes import ABSENT, Mistake
from .plan import Keys, Orders, Plan, joined, plan_of, read_plan
from .point import Record
from .report import Progress
from .resolve import resolve
from .run import Outcome, Settings, clean_caches, fruitful, job_of, provenance, tally
from .space import design_quantity, make_point
from .store import (
    SEARCH,
    OtherVersion,
    Replay,
    StoreError,
    keep_plan,
    merge,
    read_records,
    same_version,
    settle,
    study_of,
    write_whole,
)
from .supervise import CannotRun

CURVE = "hypervolume.nc"
ATTEMPTS = 100  # rounds in which designs are drawn in place of refused ones
FEWEST = 2  # trusted designs that a population needs to go on from
MARGIN = 0.1  # of the range of the first generation, by which the reference point is beyond its worst
INNER = {"pop_size": 60, "generations": 40}  # of the search over Gaussian processes

log = logging.getLogger(__name__)


# --------------------------------------------------------------------------------------------- designs


Genome = dict[str, Any]


class Genes:
    """Design variables as the algorithm sees them: [0, 1] for a range, whole numbers for the places in a list."""

    def __init__(self, study: Study) -> None:
        self.all = study.variables
        self.free = {name: v for name, v in study.variables.items() if v.options is None or len(v.options) > 1}
        if not self.free:
            raise ConfigError([Mistake("variables", ABSENT, "there is nothing to choose")], study.name)
        self.kinds = {name: _kind(variable) for name, variable in self.free.items()}

    def values(self, genome: Mapping[str, Any]) -> tuple[float, ...]:
        """The design's numbers, in the order of the variables."""
        return tuple(v.at(self._unit(genome, name, v)) for name, v in self.all.items())

    def _unit(self, genome: Mapping[str, Any], name: str, variable: Variable) -> float:
        if variable.options is None:
            return float(genome[name])
        return (int(genome.get(name, 0)) + 0.5) / len(variable.options)

    def sample(self, n: int, random: np.random.Generator) -> list[Genome]:
        """Designs that fill the space evenly (Sobol, scrambled)."""
        m = int(np.ceil(np.log2(max(n, 2))))
        units = qmc.Sobol(len(self.free), scramble=True, seed=random).random_base2(m)[:n]
        return [{name: self.at(name, float(u)) for name, u in zip(self.free, row, strict=True)} for row in units]

    def at(self, name: str, u: float) -> float | int:
        options = self.free[name].options
        return u if options is None else min(int(u * len(options)), len(options) - 1)

    def encoded(self, genomes: Sequence[Mapping[str, Any]]) -> np.ndarray:
        """(n, d) for distances: places in a list over [0, 1], a column for each of the choices."""
        columns = []
        for name, variable in self.free.items():
            column = np.array([float(genome[name]) for genome in genomes])
            if variable.choices is not None:
                columns += [(column == i).astype(float) for i in range(len(variable.options or ()))]
            else:
                columns.append(column if variable.options is None else column / (len(variable.options) - 1))
        return np.column_stack(columns)


def _kind(variable: Variable) -> Any:
    if variable.options is None:
        return Real(bounds=(0.0, 1.0))
    last = len(variable.options) - 1
    return Choice(options=list(range(last + 1))) if variable.choices is not None else Integer(bounds=(0, last))


class Gate:
    """Which designs may be run: that can be built, keep the bounds on a design's quantities, and are new."""

    def __init__(self, study: Study, genes: Genes) -> None:
        self.study, self.genes = study, genes
        self.bounds = {name: bound for name, bound in study.constraints.items() if name in DESIGN_QUANTITIES}
        self.seen: set[tuple[str, ...]] = set()
        self._tokens: dict[tuple[float, ...], tuple[str, ...] | None] = {}

    def token(self, genome: Mapping[str, Any]) -> tuple[str, ...] | None:
        """The keys of a design in its environments; None where it may not be run."""
        values = self.genes.values(genome)
        if values not in self._tokens:
            self._tokens[values] = self._keys(dict(zip(self.genes.all, values, strict=True)))
        return self._tokens[values]

    def _keys(self, values: dict[str, float]) -> tuple[str, ...] | None:
        points = [make_point(self.study, 0, e, values) for e in range(len(self.study.environments))]
        if any(point.problem for point in points):
            return None
        for name, bound in self.bounds.items():
            amount = design_quantity(self.study, values, name)
            if not ((bound.min is None or amount >= bound.min) and (bound.max is None or amount <= bound.max)):
                return None
        return tuple(point.key for point in points)

    def fresh(self, genomes: Sequence[Genome], known: set[tuple[str, ...]]) -> list[int]:
        """Places of genomes that may be run and are new; ``known`` grows by their tokens."""
        found = []
        for i, genome in enumerate(genomes):
            token = self.token(genome)
            if token is not None and token not in self.seen and token not in known:
                known.add(token)
                found.append(i)
        return found

    def draw(
        self, n: int, random: np.random.Generator, known: set[tuple[str, ...]] | None = None
    ) -> list[Genome]:
        """At most ``n`` new designs that fill the space; ``known`` are those that are new no more."""
        found: list[Genome] = []
        known = set() if known is None else known
        for _ in range(ATTEMPTS):
            if len(found) >= n:
                break
            drawn = self.genes.sample(max(n - len(found), 8), random)
            found += [drawn[i] for i in self.fresh(drawn, known)]
        return found[: max(n, 0)]


class _New(DuplicateElimination):
    """Removes offspring that the gate refuses, or that are there already."""

    def __init__(self, gate: Gate) -> None:
        super().__init__()
        self.gate = gate

    def _do(self, pop: Any, other: Any, is_duplicate: np.ndarray) -> np.ndarray:
        known = {token for ind in (other if other is not None else ()) if (token := self.gate.token(ind.X)) is not None}
        kept = self.gate.fresh([ind.X for ind in pop], known)
        is_duplicate[:] = True
        is_duplicate[kept] = False
        return is_duplicate


class _First(Sampling):
    """The first population."""

    def __init__(self, gate: Gate) -> None:
        super().__init__()
        self.gate = gate

    def _do(self, problem: Any, n_samples: int, *args: Any, random_state: Any = None, **kwargs: Any) -> Any:
        return self.gate.draw(n_samples, random_state)


# --------------------------------------------------------------------------------------------- algorithms


class Search(Protocol):
    """What asks for designs."""

    def ask(self) -> list[Genome]: ...

    def tell(self, good: np.ndarray, costs: np.ndarray, excess: np.ndarray) -> None:
        """The answers to the last question.

        Parameters
        ----------
        good : (n,) bool, which of the designs have numbers that can be trusted
        costs : (n, n_objective) less is better; read where good
        excess : (n, n_constraint) by how much each constraint is broken, at most 0 where it is kept; read where good
        """


class Evolution:
    """pymoo's NSGA-II (Deb et al. 2002) and NSGA-III (Deb and Jain 2014), with operators for each kind of variable."""

    def __init__(self, study: Study, gate: Gate, constraints: int) -> None:
        self.gate = gate
        section, n_obj = study.optimise, len(study.objectives)
        select = binary_tournament if section.algorithm == "nsga2" else comp_by_cv_then_random
        new = _New(gate)
        common = {
            "pop_size": section.population,
            "sampling": _First(gate),
            "mating": MixedVariableMating(selection=TournamentSelection(func_comp=select), eliminate_duplicates=new),
            "eliminate_duplicates": new,
            "termination": NoTermination(),
        }
        if section.algorithm == "nsga2":
            self.algorithm = NSGA2(**common)
            self.algorithm.termination = NoTermination()  # its own would look at values
        else:
            self.algorithm = NSGA3(_directions(n_obj, section.population), **common)
        problem = Problem(vars=gate.genes.kinds, n_obj=n_obj, n_ieq_constr=constraints)
        self.algorithm.setup(problem, seed=section.seed)
        self.asked: Any = None
        self._waiting: Any = Population.empty()  # of a first population that is not large enough yet

    def ask(self) -> list[Genome]:
        found = self.algorithm.ask()
        self.algorithm.termination.force_termination = False  # set where mating finds nothing new
        born = [] if found is None else [ind.X for ind in found]
        known = {token for genome in born if (token := self.gate.token(genome)) is not None}
        more = self.gate.draw(self.algorithm.pop_size - len(born), self.algorithm.random_state, known)
        self.asked = Population.new(X=born + more)
        return born + more

    def tell(self, good: np.ndarray, costs: np.ndarray, excess: np.ndarray) -> None:
        places = np.flatnonzero(good)
        told = self.asked[places]
        for ind, place in zip(told, places, strict=True):
            ind.set("F", costs[place].astype(float))
            ind.set("G", excess[place].astype(float))
            ind.evaluated.update(("F", "G", "H"))
        if not self.algorithm.is_initialized:
            told = self._waiting = Population.merge(self._waiting, told)
            if len(told) < FEWEST:
                return  # the next question draws another first population
        self.algorithm.tell(infills=told if len(told) else None)


def _directions(n_obj: int, most: int) -> np.ndarray:
    """Reference directions: as many as fit the population, spread evenly (Das and Dennis 1998)."""
    found = get_reference_directions("das-dennis", n_obj, n_partitions=1)
    for parts in range(2, most + 1):
        finer = get_reference_directions("das-dennis", n_obj, n_partitions=parts)
        if len(finer) > most:
            break
        found = finer
    return np.asarray(found)


class Surrogate:
    """Gaussian processes in place of most runs.

    One process for each objective and constraint, fitted to all trusted rows (Matern 5/2, a length for each variable,
    noise). NSGA-II looks for the front of their optimistic bounds (mean less one standard deviation) where constraints
    are expected to be kept; of what it finds, those designs are asked for that would add most hypervolume to the front
    of the rows, one after the other (as S-metric selection: Ponweiser et al. 2008).
    """

    def __init__(self, study: Study, gate: Gate, constraints: int) -> None:
        need_sklearn()
        self.section, self.gate, self.genes = study.optimise, gate, gate.genes
        self.n_obj, self.n_con = len(study.objectives), constraints
        self.random = np.random.default_rng(self.section.seed)
        self.asked: list[Genome] = []
        self.known: list[Genome] = []
        self.costs = np.zeros((0, self.n_obj))
        self.excess = np.zeros((0, constraints))

    def ask(self) -> list[Genome]:
        if len(self.known) < max(FEWEST, 4):
            self.asked = self.gate.draw(self.section.population, self.random)
        else:
            self.asked = self._infill()
        return self.asked

    def tell(self, good: np.ndarray, costs: np.ndarray, excess: np.ndarray) -> None:
        places = np.flatnonzero(good)
        self.known += [self.asked[i] for i in places]
        self.costs = np.vstack([self.costs, costs[places]])
        self.excess = np.vstack([self.excess, excess[places]])

    def _infill(self) -> list[Genome]:
        from threadpoolctl import threadpool_limits

        with threadpool_limits(1):  # sums in another order would be other designs
            x = self.genes.encoded(self.known)
            low, span = self.costs.min(axis=0), np.ptp(self.costs, axis=0)
            scaled = (self.costs - low) / np.where(span > 0, span, 1.0)
            models = [self._fitted(x, column) for column in (*scaled.T, *self.excess.T)]
            found, costs = self._front(models)
        feasible = scaled[(self.excess <= 0).all(axis=1)]
        chosen = _greedy(costs, feasible, self.section.batch)
        return [found[i] for i in chosen] or self.gate.draw(self.section.batch, self.random)

    def _fitted(self, x: np.ndarray, y: np.ndarray) -> Any:
        import warnings

        from sklearn.exceptions import ConvergenceWarning
        from sklearn.gaussian_process import GaussianProcessRegressor
        from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

        shape = Matern(length_scale=np.full(x.shape[1], 0.5), length_scale_bounds=(0.05, 20.0), nu=2.5)
        kernel = ConstantKernel(1.0, (0.05, 20.0)) * shape + WhiteKernel(0.1, (1e-6, 2.0))
        model = GaussianProcessRegressor(kernel, normalize_y=True)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)  # a length at its bound: the variable does not matter
            return model.fit(x, y)

    def _front(self, models: Sequence[Any]) -> tuple[list[Genome], np.ndarray]:
        """Designs that the processes expect most of, and their optimistic costs."""
        genes, n_obj = self.genes, self.n_obj

        class Guess(Problem):
            def __init__(self, constraints: int) -> None:
                super().__init__(vars=genes.kinds, n_obj=n_obj, n_ieq_constr=constraints)

            def _evaluate(self, x: Any, out: dict[str, Any], *args: Any, **kwargs: Any) -> None:
                places = genes.encoded(list(x))
                guessed = [model.predict(places, return_std=True) for model in models]
                out["F"] = np.column_stack([mean - deviation for mean, deviation in guessed[:n_obj]])
                if len(guessed) > n_obj:
                    out["G"] = np.column_stack([mean for mean, _ in guessed[n_obj:]])

        first = self.genes.sample(INNER["pop_size"] // 2, self.random)
        best = NonDominatedSorting().do(self.costs, only_non_dominated_front=True)
        first += [self.known[i] for i in best][: INNER["pop_size"] // 2]
        algorithm = NSGA2(
            pop_size=INNER["pop_size"],
            sampling=Population.new(X=first),
            mating=MixedVariableMating(
                selection=TournamentSelection(func_comp=binary_tournament),
                eliminate_duplicates=_Other(genes),
                n_max_iterations=3,  # a small space has few others
            ),
            eliminate_duplicates=_Other(genes),
        )
        algorithm.termination = NoTermination()
        algorithm.setup(Guess(self.n_con), seed=int(self.random.integers(2**31)))
        for _ in range(INNER["generations"]):
            algorithm.next()
        found = [ind for ind in algorithm.pop if ind.FEAS[0]] or list(algorithm.pop)
        kept = self.gate.fresh([ind.X for ind in found], set())
        return [found[i].X for i in kept], np.array([found[i].F for i in kept]).reshape(-1, n_obj)


class _Other(DuplicateElimination):
    """Removes offspring that are there already, by value."""

    def __init__(self, genes: Genes) -> None:
        super().__init__()
        self.genes = genes

    def _do(self, pop: Any, other: Any, is_duplicate: np.ndarray) -> np.ndarray:
        known = {self.genes.values(ind.X) for ind in (other if other is not None else ())}
        for i, ind in enumerate(pop):
            values = self.genes.values(ind.X)
            is_duplicate[i] = values in known
            known.add(values)
        return is_duplicate


def _greedy(costs: np.ndarray, front: np.ndarray, most: int) -> list[int]:
    """Candidates that add most hypervolume to a front, one after the other; scaled costs, reference 1.1."""
    reference = np.full(costs.shape[1], 1.0 + MARGIN)
    chosen: list[int] = []
    left = list(range(len(costs)))
    while left and len(chosen) < most:
        volumes = [volume(np.vstack([front, costs[[i]]]), reference) for i in left]
        best = left.pop(int(np.argmax(volumes)))
        chosen.append(best)
        front = np.vstack([front, costs[[best]]])
    return chosen


def need_sklearn() -> None:
    """CannotRun with the cure where scikit-learn is not installed."""
    try:
        import sklearn  # noqa: F401
    except ImportError:
        cure = "pip install 'cable-sweep[analysis]', or choose nsga2 or nsga3"
        raise CannotRun(f"`algorithm: gp` needs scikit-learn, which is not installed: {cure}") from None


def search_for(study: Study, gate: Gate, constraints: int) -> Search:
    kind = Surrogate if study.optimise.algorithm == "gp" else Evolution
    return kind(study, gate, constraints)


# --------------------------------------------------------------------------------------------- what rows say


def volume(costs: np.ndarray, reference: np.ndarray) -> float:
    """Hypervolume between points (n, n_objective), less is better, and a reference point; 0 where none is below it."""
    inside = costs[(costs < reference).all(axis=1)] if len(costs) else costs
    return float(HV(ref_point=reference)(inside)) if len(inside) else 0.0


@dataclass
class Answers:
    """The rows of some designs as the search needs them."""

    good: np.ndarray  # (n,) trusted, and every number finite
    costs: np.ndarray  # (n, n_objective)
    excess: np.ndarray  # (n, n_constraint), each over the size of its bound
    trusted: np.ndarray  # (n,)

    @property
    def allowed(self) -> np.ndarray:
        return self.good & (self.excess <= 0).all(axis=1)


def answers(study: Study, plan: Plan, rows: Mapping[str, Record]) -> Answers:
    """What `pareto` makes of the rows of a plan, which is what a front is made of later."""
    dataset = assemble(study, plan, rows)
    costs = pareto.costs(dataset, study.objectives)
    columns = [over / scale for over, scale in zip(pareto.excesses(dataset).values(), _scales(study), strict=True)]
    excess = np.column_stack(columns) if columns else np.zeros((len(costs), 0))
    trusted = pareto.trusted(dataset)
    good = trusted & np.isfinite(costs).all(axis=1) & np.isfinite(excess).all(axis=1)
    return Answers(good, costs, excess, trusted)


def _scales(study: Study) -> list[float]:
    """The sizes of the bounds: violations of different constraints are added up."""
    ends = [end for bound in study.constraints.values() for end in (bound.min, bound.max) if end is not None]
    return [abs(end) or 1.0 for end in ends]


@dataclass
class Curve:
    """Hypervolume over evaluations, with what it is counted from."""

    study: Study
    reference: np.ndarray | None  # of costs; None until a generation has a front
    front: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    rows: list[tuple[int, float, int, int, int]] = field(default_factory=list)

    def add(self, count: int, found: Answers, complete: bool) -> None:
        """A generation: ``count`` designs by its end."""
        if not self.front.size:
            self.front = np.zeros((0, found.costs.shape[1]))
        mine = found.costs[found.allowed]
        if self.reference is None and complete and len(mine):
            span = np.ptp(mine, axis=0)
            self.reference = mine.max(axis=0) + MARGIN * np.where(span > 0, span, np.abs(mine[0]) + 1.0)
        both = np.vstack([self.front, mine])
        if len(both):
            self.front = both[NonDominatedSorting().do(both, only_non_dominated_front=True)]
        size = volume(self.front, self.reference) if self.reference is not None else np.nan
        untrusted = int(np.count_nonzero(~found.trusted))
        self.rows.append((count, size, len(self.front), untrusted, int(np.count_nonzero(found.good & ~found.allowed))))

    def named(self) -> dict[str, float]:
        """The reference point by objective, as users read it."""
        if self.reference is None:
            return {}
        return {
            name: float(value if pareto.direction(name) == "min" else -value)
            for name, value in zip(self.study.objectives, self.reference, strict=True)
        }

    def dataset(self, versions: Mapping[str, str]) -> xr.Dataset:
        """What is kept in ``hypervolume.nc``."""
        about = {
            "evaluations": ("1", "designs run by the end of the generation"),
            "hypervolume": ("1", "volume between the front and the reference point, in units of the objectives"),
            "front": ("1", "designs on the front"),
            "untrusted": ("1", "designs of the generation that failed or are not trusted"),
            "left_out": ("1", "trusted designs of the generation that break a constraint"),
        }
        columns = np.array(self.rows, dtype=float).reshape(-1, len(about)).T
        data = {
            name: ("generation", column, {"units": unit, "long_name": meaning})
            for (name, (unit, meaning)), column in zip(about.items(), columns, strict=True)
        }
        section = self.study.optimise
        return xr.Dataset(
            data,
            attrs={
                "title": self.study.name,
                "objectives": json.dumps(list(self.study.objectives)),
                "reference": json.dumps(self.named()),
                "algorithm": section.algorithm,
                "seed": section.seed,
                "versions": json.dumps(dict(versions)),
            },
        )


def given_reference(study: Study) -> np.ndarray | None:
    """The study's reference point, turned so that less is better."""
    given = study.optimise.reference
    if not given:
        return None
    return np.array([given[n] if pareto.direction(n) == "min" else -given[n] for n in study.objectives])


# --------------------------------------------------------------------------------------------- the folder


def versions_of(study: Study) -> dict[str, str]:
    """Packages that the designs hang on, beside the solver's."""
    names = ["pymoo", "numpy", "scipy"] + ["scikit-learn"] * (study.optimise.algorithm == "gp")
    return {name: importlib.metadata.version(name) for name in names}


@dataclass(frozen=True, kw_only=True)
class Progressed:
    """How far the search of a folder is."""

    algorithm: str
    evaluations: int  # wanted
    done: int  # designs that have all their rows
    ended: str  # why, or nothing

    def __str__(self) -> str:
        text = f"{self.done} of {self.evaluations} evaluations by {self.algorithm}"
        return f"{text}: {self.ended}" if self.ended else text


def progress_of(directory: str | Path) -> Progressed | None:
    """How far a folder's search is; None for the folder of a sweep."""
    path = Path(directory) / SEARCH
    if not path.is_file():
        return None
    known = json.loads(path.read_text(encoding="utf-8"))
    plan = read_plan(Path(directory) / "plan.json")
    replay = Replay(directory, plan.keys)
    there = (replay.status[replay.firsts(slice(None))] != 0).reshape(len(plan.designs), -1).all(axis=1)
    return Progressed(
        algorithm=known["algorithm"], evaluations=known["evaluations"], done=int(there.sum()), ended=known["ended"]
    )


def _opened(directory: Path, study: Study, any_version: bool) -> Plan | None:
    """The plan that a folder holds of this study's search; refuses the folder of a sweep and other versions."""
    place = directory / "plan.json"
    if not (directory / SEARCH).is_file():
        if place.is_file():
            raise StoreError(f"{directory} holds a sweep: `sweep optimise` needs a folder of its own")
        return None
    known = json.loads((directory / SEARCH).read_text(encoding="utf-8"))
    mine = versions_of(study)
    others = [f"{name} {v}" for name, v in known["versions"].items() if mine.get(name, v) != v]
    if others and not any_version:
        raise OtherVersion(
            f"{directory} was searched with {', '.join(others)} (here: "
            f"{', '.join(f'{name} {v}' for name, v in mine.items())}), which may ask for other designs. "
            "Use that version or another folder, or add --force-version."
        )
    if not place.is_file():
        return None
    plan = read_plan(place)
    if plan.text != study.text and not _same_search(study, study_of(directory)):
        log.warning("%s is of an earlier form of this study; points that did not change are kept", place)
        return None
    return plan


def _same_search(one: Study, other: Study) -> bool:
    """Whether two forms of a study ask for the same designs: they differ in the number of evaluations at most."""
    trees = [yaml.safe_load(study.text) for study in (one, other)]
    for tree in trees:
        section = tree.pop("optimise", None) or {}
        tree["search"] = {name: value for name, value in section.items() if name not in ("evaluations", "reference")}
    return bool(trees[0] == trees[1])


# --------------------------------------------------------------------------------------------- the loop


@dataclass
class _Run:
    """A search at work in a folder."""

    study: Study
    settings: Settings
    ranks: distribute.World
    budget: int
    lock: locks.Lock
    header: dict[str, Any]
    stored: Plan | None
    rows: dict[str, Record]
    turn: int

    def __post_init__(self) -> None:
        self.genes = Genes(self.study)
        self.gate = Gate(self.study, self.genes)
        self.search = search_for(self.study, self.gate, len(_scales(self.study)))
        self.curve = Curve(self.study, given_reference(self.study))
        self.plan: Plan | None = None
        self.before = 0  # points that had rows
        self.interrupted = self.ended = ""
        self.crew: distribute.Crew | None = None
        self.progress: Progress | None = None

    @property
    def count(self) -> int:
        return 0 if self.plan is None else len(self.plan.designs)

    def go(self) -> None:
        """Generation after generation, until the budget is spent or no new design is found."""
        with ExitStack() as stack:
            while not self.interrupted and not self.ended:
                asked = self.search.ask()
                part = asked[: self.budget - self.count]
                if not part:
                    self.ended = "no new design is left" if not asked else "the budget is spent"
                    break
                self.gate.seen.update(token for genome in asked if (token := self.gate.token(genome)))
                values = np.array([self.genes.values(genome) for genome in part])
                piece = plan_of(self.study, values)
                self.extend(piece)
                self.answer(piece, stack)
                if self.interrupted:
                    break
                found = answers(self.study, piece, self.rows)
                complete = len(part) == len(asked)
                self.curve.add(self.count, found, complete)
                if self.crew is not None:  # what the store had is written already
                    self.keep()
                if self.count >= self.budget:
                    self.ended = "the budget is spent"
                if complete:
                    self.search.tell(found.good, found.costs, found.excess)
        self.keep()

    def extend(self, piece: Plan) -> None:
        """Add a generation to the plan, which is that of the store as far as it goes."""
        begin = self.count
        self.plan = piece if self.plan is None else joined(self.plan, piece)
        stored = self.stored
        if stored is not None:
            end = min(len(stored.designs), self.count)
            if not np.array_equal(stored.designs.values[begin:end], self.plan.designs.values[begin:end]):
                problem = f"generation after {begin} designs: other designs than {self.settings.directory} holds"
                if not self.settings.any_version:
                    why = "Random numbers, pymoo or stored rows have changed; --force-version goes on from here."
                    raise OtherVersion(f"{problem}. {why}")
                log.warning("%s; the plan is written anew from there", problem)
                self.stored = stored = None
        if stored is None or self.count > len(stored.designs) or stored.text != self.study.text:
            keep_plan(self.study, self.plan, self.settings.directory)
            self.stored = None

    def answer(self, piece: Plan, stack: ExitStack) -> None:
        """Run the points of a generation that have no row."""
        left = np.array([i for i, key in enumerate(piece.keys) if key not in self.rows], dtype=int)
        self.before += len(piece) - len(left)
        if not len(left):
            return
        if self.crew is None:
            self.progress = Progress(self.budget * len(piece.environments) - self.before)
            job = replace(job_of(self.study, self.settings, self.header, "", self.turn), batches=True)
            self.crew = stack.enter_context(distribute.Crew(job, self.ranks, self.progress.report, self._beat))
        records, self.interrupted = self.crew.map(Orders.of(piece, left))
        self.rows.update(settle(records))

    def _beat(self) -> None:
        assert self.progress is not None
        self.progress.beat()
        if self.lock.lost:
            raise StoreError(f"{self.lock.path} was taken by another run: this one stops")

    def keep(self) -> None:
        """Write what is known of the search."""
        versions = versions_of(self.study)
        state = {
            "algorithm": self.study.optimise.algorithm,
            "seed": self.study.optimise.seed,
            "evaluations": self.budget,
            "ended": self.ended,
            "versions": versions,
            "reference": self.curve.named(),
        }
        text = json.dumps(state, indent=1)
        directory = self.settings.directory
        write_whole(directory / SEARCH, lambda place: place.write_text(text, encoding="utf-8"))
        if self.curve.rows:
            data = self.curve.dataset(versions)
            write_whole(directory / CURVE, lambda place: data.to_netcdf(place, engine="netcdf4"))


def optimise(
    study: Study, settings: Settings, evaluations: int | None = None, ranks: distribute.World | None = None
) -> Outcome:
    """Look for the front of a study; rank 0 calls this while the other ranks ``distribute.serve``.

    Parameters
    ----------
    evaluations : distinct designs in all, by default those of the study; what a folder has begun is finished

    Raises ConfigError, CannotRun, StoreError.
    """
    ranks = ranks or distribute.Alone()
    directory = settings.directory
    study = resolve(study, directory)[0]
    header = provenance(study)
    lock = locks.acquire(directory, "", header["study"])
    try:
        clean_caches()
        stored = _opened(directory, study, settings.any_version)
        replay = Replay(directory, Keys(np.zeros(0, dtype=np.uint64)))
        if not settings.any_version:
            same_version(directory, header["solver"], replay.headers)
        fruitful(replay, "")
        work = _Run(
            study=study,
            settings=settings,
            ranks=ranks,
            budget=max(evaluations or study.optimise.evaluations, 0 if stored is None else len(stored.designs)),
            lock=lock,
            header=header,
            stored=stored,
            rows=settle(read_records(directory)),
            turn=replay.turn + 1,
        )
        work.keep()
        log.info("%s, %d evaluations, on %d ranks", study.optimise.algorithm, work.budget, ranks.size)
        work.go()
        groups: Counter[tuple[str, str]] = Counter()
        planned = 0
        if work.plan is not None:
            places = work.plan.slice(0, 1)
            planned, groups = len(places), tally(Replay(directory, work.plan.keys), places)
        return Outcome(
            planned=planned,
            before=work.before,
            groups=groups,
            interrupted=work.interrupted,
            results=merge(directory) if planned and not work.interrupted else None,
        )
    finally:
        lock.release()
