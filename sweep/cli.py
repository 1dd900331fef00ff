"""The commands. Options say where and how much; what is computed stands in the study alone.

Exit codes: 0 good (untrusted points only warn), 1 finished with failed points, 2 bad input, 3 interrupted and
resumable.
"""

from __future__ import annotations

import json
import logging
import math
import os
import sys
from collections.abc import Callable
from enum import StrEnum
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer
from rich.console import Console

from solvers import METHODS, MODELS, CannotRepresent, warm_up

from . import config, distribute, locks, pareto, report, store
from . import plan as planning
from . import run as running
from . import submit as submitting
from .resolve import about_mesh, resolve
from .space import extremes
from .supervise import fork_spare

if TYPE_CHECKING:
    import xarray as xr

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    help="Parallel parameter studies of subsea cables with nonlinear energy sinks: from one YAML to a front.",
)
BAD_INPUT = (config.ConfigError, store.StoreError, distribute.CannotRun, CannotRepresent)
Folder = Annotated[Path, typer.Argument(metavar="DIR", help="a study's results folder")]
File = Annotated[Path, typer.Argument(metavar="STUDY.yaml", help="the study")]
Limit = Annotated[int | None, typer.Option(min=1, metavar="N", help="the first N designs only")]


class Retry(StrEnum):
    """Which finished points to run again."""

    failed = "failed"
    untrusted = "untrusted"
    timeout = "timeout"
    memory = "memory"


def say(text: object = "", err: bool = False) -> None:
    try:
        typer.echo(str(text), err=err)
    except OSError:  # `sweep show ... | head`, a job's log on a full disk: the work goes on, what it says goes nowhere
        os.dup2(os.open(os.devnull, os.O_WRONLY), (sys.stderr if err else sys.stdout).fileno())


def complain(error: BaseException) -> int:
    """Print what is wrong as a sentence; the exit code."""
    say(error, err=True)
    return 3 if getattr(error, "resumable", False) else 2


def main() -> None:
    """Run a command; bad input is a sentence and exit code 2, never a traceback."""
    try:
        app(prog_name="sweep")
    except BAD_INPUT as error:
        sys.exit(complain(error))


# --------------------------------------------------------------------------------------------- before a run


@app.command()
def init(directory: Annotated[Path, typer.Argument(metavar="DIR", help="folder to be; made if need be")]) -> None:
    """Write a commented starter study: study.yaml and the scene beside it."""
    starter = resources.files("sweep") / "starter"
    files = sorted((entry for entry in starter.iterdir() if entry.name.endswith(".yaml")), key=lambda entry: entry.name)
    if there := [entry.name for entry in files if (directory / entry.name).exists()]:
        raise store.StoreError(f"{directory} has {' and '.join(there)} already: name another folder")
    try:
        directory.mkdir(parents=True, exist_ok=True)
        for entry in files:
            (directory / entry.name).write_text(entry.read_text(encoding="utf-8"), encoding="utf-8")
    except OSError as error:
        raise store.StoreError(f"{directory} cannot be written: {error.strerror}") from None
    say(f"wrote {', '.join(str(directory / entry.name) for entry in files)}")
    say(f"next: sweep check {directory / 'study.yaml'}; sweep run {directory / 'study.yaml'} --out {directory / 'out'}")


@app.command()
def check(
    study: File,
    limit: Limit = None,
    designs: Annotated[
        Path | None, typer.Option(metavar="FRONT.nc", help="the designs of this front or results.nc instead")
    ] = None,
) -> None:
    """What would run: points, model and method and why, resolution, cost and disk. Runs a few pilots."""
    warm_up()
    loaded, because = resolve(config.load_study(study, designs))
    if loaded.sampler is None:  # the designs of a search are not known; its pilots stand for them
        tried = [list(values.values()) for values in extremes(loaded).values()]
        plan = planning.plan_of(loaded, np.array(tried)[:limit])
    else:
        plan = planning.make_plan(loaded, limit)
    for label, why in because.items():
        say(f"mesh         {label}: {why}")
    pilots = planning.pilot(loaded)
    if note := about_mesh(loaded, pilots[0].response):
        say(f"mesh         {note}")
    say(report.describe(loaded, plan, pilots))


@app.command()
def models() -> None:
    """The models of a cable and the methods that march them."""
    for title, catalogue in (("models", MODELS), ("methods", METHODS)):
        rows = [(name, report.about(entry)) for name, entry in catalogue.items()]
        say(report.table(title, ("name", "what it is"), rows, Console()) + "\n")


@app.command()
def metrics() -> None:
    """Every metric: unit, which way is better, definition."""
    rows = [
        (m.name + ("[_i]" if m.per_device else ""), m.unit, m.direction or "-", m.definition, m.equation)
        for m in config.METRICS.values()
    ]
    say(report.table("", ("metric", "unit", "better", "definition", "equation"), rows, Console()))
    say(f"\n{report.SUFFIXES}")


@app.command()
def schema() -> None:
    """JSON schema of a study, for editors."""
    say(json.dumps(config.study_schema(), indent=1))


# --------------------------------------------------------------------------------------------- running


def _slice(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    k, _, n = text.partition("/")
    if not (k.isdigit() and n.isdigit() and int(k) < int(n)):
        raise typer.BadParameter(f"{text!r} is not K/N with K from 0 to N-1", param_hint="--part")
    return int(k), int(n)


@app.command()
def run(
    study: File,
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="results folder; what is done there is not run again")
    ],
    limit: Limit = None,
    part: Annotated[
        str | None, typer.Option(metavar="K/N", help="slice K of N (K = 0 to N-1), then `merge`")
    ] = None,
    retry: Annotated[list[Retry] | None, typer.Option(help="run these again; may be given twice")] = None,
    force_version: Annotated[bool, typer.Option(help="add to rows of another solver version")] = False,
    designs: Annotated[
        Path | None, typer.Option(metavar="FRONT.nc", help="run the designs of this front or results.nc instead")
    ] = None,
) -> None:
    """Run what is missing, on this core or, under `mpirun -n P python -m mpi4py -m sweep run`, on P."""

    def work(ranks: distribute.World) -> running.Outcome:
        settings = running.Settings(
            directory=out,
            limit=limit,
            part=_slice(part),
            retry=frozenset(kind.value for kind in retry or ()),
            any_version=force_version,
        )
        return running.run(config.load_study(study, designs), settings, ranks)

    _on_ranks(work, lambda ended: report.ending(ended.groups, ended.interrupted, ended.results, out))


def _on_ranks(work: Callable[[distribute.World], Any], told: Callable[[Any], str]) -> None:
    """Do the work on rank 0 while the other ranks serve; say how it ended, and end them all with its exit code."""
    fork_spare()  # before MPI begins
    ranks = distribute.world()
    _log(ranks)
    if ranks.rank > 0:
        raise typer.Exit(distribute.serve(ranks))
    code = 2
    try:
        ended = work(ranks)
        code = ended.exit_code
        say(told(ended))
    except BAD_INPUT as error:
        code = complain(error)
    except KeyboardInterrupt:
        code = 3
    finally:
        distribute.dismiss(ranks, code)
    raise typer.Exit(code)


@app.command(name="optimise")
def optimise_command(
    study: File,
    out: Annotated[Path, typer.Option(metavar="DIR", help="results folder; what is done there is not run again")],
    evaluations: Annotated[
        int | None, typer.Option(min=1, metavar="N", help="distinct designs to run in all, instead of the study's")
    ] = None,
    force_version: Annotated[bool, typer.Option(help="go on with other versions of the solver or of pymoo")] = False,
) -> None:
    """Look for the front, on this core or, under `mpirun -n P python -m mpi4py -m sweep optimise`, on P; resumes."""
    from . import optimise

    settings = running.Settings(directory=out, any_version=force_version)

    def told(ended: running.Outcome) -> str:
        return (
            f"{report.ending(ended.groups, ended.interrupted, ended.results, out)}\n"
            f"search     {optimise.progress_of(out)}\nthen       sweep pareto {out}; sweep plot {out} hypervolume"
        )

    _on_ranks(lambda ranks: optimise.optimise(config.load_study(study), settings, evaluations, ranks), told)


def _log(ranks: distribute.World) -> None:
    """Rank 0 tells, the others warn; each line says whose it is where there are several ranks or tasks."""
    job, rank = store.job_name(), f"{ranks.rank}/{ranks.size}" if ranks.size > 1 else ""
    who = " ".join(word for word in (job and f"job {job}", rank and f"rank {rank}") if word)
    logging.basicConfig(
        level=logging.INFO if ranks.rank == 0 else logging.WARNING,
        format="%(asctime)s " + (f"[{who}] " if who else "") + "%(message)s",
        datefmt="%m-%d %H:%M:%S" if job else "%H:%M:%S",
        stream=sys.stderr,
    )


@app.command()
def submit(
    study: File,
    out: Annotated[Path, typer.Option(metavar="DIR", help="results folder; scripts and logs go there too")],
    array: Annotated[int | None, typer.Option(min=1, metavar="K", help="K tasks of one core, without MPI")] = None,
    ranks: Annotated[int | None, typer.Option(min=1, metavar="P", help="one MPI job of P ranks")] = None,
    hours: Annotated[str | None, typer.Option("--time", metavar="HH:MM:SS", help="time limit of a job")] = None,
    partition: Annotated[str | None, typer.Option(help="SLURM partition")] = None,
    account: Annotated[str | None, typer.Option(help="SLURM account")] = None,
    site: Annotated[Path | None, typer.Option(metavar="FILE", help="options of your cluster [slurm/site.yaml]")] = None,
    pilots: Annotated[int, typer.Option(min=0, metavar="N", help="points to run first, here, to predict costs")] = 8,
    limit: Limit = None,
    retry: Annotated[list[Retry] | None, typer.Option(help="run these again; may be given twice")] = None,
    search: Annotated[bool, typer.Option("--optimise", help="`sweep optimise` in place of `sweep run`")] = False,
    evaluations: Annotated[int | None, typer.Option(min=1, metavar="N", help="of --optimise: designs in all")] = None,
    force_version: Annotated[bool, typer.Option(help="add to rows of another solver version")] = False,
    dry_run: Annotated[bool, typer.Option(help="show scripts and commands; run and write nothing")] = False,
) -> None:
    """Run what is missing as SLURM jobs, and merge after them.

    The designs of a front, which `sweep run` takes by --designs, stand in the study here: its sampler is then
    `{kind: given, file: front.nc}`.
    """
    if (array is None) == (ranks is None):
        raise typer.BadParameter("one of --array K and --ranks P is needed", param_hint="--array, --ranks")
    if search and (array is not None or limit is not None or retry):
        problem = "designs are asked for generation by generation: use --ranks P, without --limit and --retry"
        raise typer.BadParameter(problem, param_hint="--optimise")
    if evaluations is not None and not search:
        raise typer.BadParameter("belongs to --optimise", param_hint="--evaluations")
    _log(distribute.Alone())
    kinds = [kind.value for kind in retry or ()]
    extra = [f"--limit={limit}"] * (limit is not None) + [f"--retry={kind}" for kind in kinds]
    extra += [f"--evaluations={evaluations}"] * (evaluations is not None)
    given = {"time": hours, "partition": partition, "account": account}
    settings = running.Settings(directory=out, limit=limit, retry=frozenset(kinds), any_version=force_version)
    request = submitting.Request(
        array=array,
        ranks=ranks,
        options={name: value for name, value in given.items() if value},
        pilots=pilots,
        extra=[*extra, *["--force-version"] * force_version],
        search=search,
    )
    loaded = config.load_study(study)
    for line in submitting.submit(loaded, settings, request, submitting.load_site(site), dry_run):
        say(line)


@app.command()
def merge(directory: Folder) -> None:
    """Make DIR/results.nc of what the runs and slices have written."""
    say(store.merge(directory))


@app.command()
def status(
    directory: Folder,
    missing: Annotated[bool, typer.Option("--missing", help="exit code 3 while points are to go")] = False,
) -> None:
    """What is done, what failed and why, how fast and by whom, and how long the rest will take; changes nothing."""
    store.study_of(directory)
    plan = planning.read_plan(directory / "plan.json")
    replay = store.Replay(directory, plan.keys)
    groups = running.tally(replay, plan.slice(0, 1))
    live = locks.holders(directory)
    say(report.trust_summary(groups))
    if replay.journals:
        say(report.writers_table(replay.journals, live, locks.server_clock(directory / "parts"), Console()))
    to_go = groups["MISSING", ""]
    if store.searched(directory):
        from . import optimise

        search = optimise.progress_of(directory)
        say(f"search     {search}")
        left = 0 if search is None or search.ended else max(search.evaluations - search.done, 1)
        to_go = left * len(plan.environments)
    parts = {holder.part for holder in live}
    pace = sum(journal.pace for journal in replay.journals if journal.writer.rpartition("-")[0] in parts)
    say(report.outlook(to_go, pace, len(live)))
    if missing and to_go:
        running.begun(directory)
        raise typer.Exit(3)


# --------------------------------------------------------------------------------------------- trade-offs


@app.command(name="chart")
def chart_command(
    case: Annotated[Path, typer.Argument(metavar="SCENE.yaml", help="a study, whose first design counts, or a scene")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="folder of chart.csv, chart.nc and chart.png")],
    duration: Annotated[float | None, typer.Option(min=0, metavar="T", help="length of the runs [s]")] = None,
    model: Annotated[list[str] | None, typer.Option(help="this line only; may be given again")] = None,
    uncertainty: Annotated[float, typer.Option(help="wanted of the reference, relative")] = 1e-3,
    longest: Annotated[float, typer.Option(help="longest run worth making [s]")] = 20.0,
) -> None:
    """Error against cost of every line and method that can do a scene, beside a reference that is checked."""
    from . import chart
    from .chart_plot import save_chart

    warm_up()
    data = chart.chart(chart.load_case(case, duration), out, model or (), uncertainty, longest, say)
    say(report.charted(data, Console()))
    say(f"figure  {save_chart(data, out / 'chart.png')}")


@app.command(name="stability")
def stability_command(
    case: Annotated[Path, typer.Argument(metavar="SCENE.yaml", help="a study or a scene")],
    out: Annotated[Path, typer.Option(metavar="DIR", help="folder of stability.csv, stability.nc and stability.png")],
    over: Annotated[str, typer.Option(metavar="FIELD", help="field that varies: `devices[0].EA`, `ask.segments`")] = "",
    span: Annotated[
        tuple[float, float] | None, typer.Option("--range", metavar="LOW HIGH", help="of the field")
    ] = None,
    points: Annotated[int, typer.Option(min=1, metavar="N", help="values of the field")] = 5,
    steps: Annotated[int, typer.Option(metavar="M", help="steps about the limit, or tolerances, of each method")] = 9,
    duration: Annotated[float, typer.Option(metavar="T", help="of each run [s]; short where it is chaotic")] = 0.5,
    segments: Annotated[int, typer.Option(metavar="N", help="mesh of all runs")] = 20,
    accuracy: Annotated[float, typer.Option(help="that is asked of the waveform")] = 0.05,
    limit: Annotated[int, typer.Option(min=1, metavar="N", help="most steps of one run")] = 150_000,
    model: Annotated[list[str] | None, typer.Option(help="a line, by default lumped; may be given again")] = None,
    method: Annotated[list[str] | None, typer.Option(help="this method only; may be given again")] = None,
) -> None:
    """Where each method fails on a scene, over its step or tolerance and a field; limits in theory; needs seconds to
    minutes."""
    from . import stability as maps
    from .stability_plot import save_map

    values = maps.spread(*span, points) if span else (math.nan,)
    what = maps.checked(maps.Over(
        field=over, values=values, steps=steps, duration=duration, segments=segments, accuracy=accuracy, most=limit,
        models=tuple(model or ("lumped",)), methods=tuple(method or maps.ALL),
    ))  # fmt: skip
    scene, study = maps.load(case)
    warm_up()
    rows = maps.cells(scene, what, study.ask if study else None, say)
    data = maps.dataset(rows, what, scene)
    say("\n" + report.table("outcomes", *maps.summary(rows), Console()))
    for line in maps.worst(rows):
        say(line)
    say(f"good runs that were called bad: {maps.false_alarms(rows):.1%}")
    table, whole = maps.save(data, out)
    say(f"runs    {table}\n        {whole}\nfigure  {save_map(data, out / 'stability.png')}")


# --------------------------------------------------------------------------------------------- results


def _key(dataset: xr.Dataset, text: str) -> str:
    """The key that a user means: whole, a prefix that is unique, or ``best``."""
    keys = dataset["key"].values
    if text == "best":
        chosen = pareto.best(dataset, json.loads(dataset.attrs["objectives"]))
        if chosen is None:
            raise store.StoreError("there is no trusted point yet, and so no best one")
        return str(keys[chosen] if keys.ndim == 1 else keys[chosen, 0])
    every = [str(key) for key in keys.ravel()]
    found = [key for key in every if key.startswith(text)]
    if text in every or len(set(found)) == 1:
        return text if text in every else found[0]
    raise store.StoreError(report.no_such_key(text, every, found))


@app.command()
def show(
    directory: Folder,
    key: Annotated[str, typer.Argument(metavar="best|KEY", help="the key, or its beginning")],
) -> None:
    """One design: its variables, how it ended, its metrics."""
    dataset = store.open_study(directory)
    say(report.one_point(dataset, _key(dataset, key), criterion=key == "best"))


@app.command()
def rerun(
    directory: Folder,
    key: Annotated[str, typer.Argument(metavar="best|KEY", help="the key, or its beginning")],
) -> None:
    """Run one design again and compare with its row, bit for bit."""
    dataset = store.open_study(directory)
    whole = _key(dataset, key)
    new, old = running.rerun(directory, whole)
    if old is None:
        say(f"{whole}: {new.status}; there is no row to compare with")
        return
    found = running.differences(new, old)
    if found:
        say(f"{whole}: {new.status}, and it differs from its row:\n  " + "\n  ".join(found))
        raise typer.Exit(1)
    say(f"{whole}: {new.status}, the same as its row bit for bit ({len(new.metrics)} metrics)")


@app.command(name="pareto")
def pareto_command(
    directory: Folder,
    significant: Annotated[
        bool, typer.Option(help="one point of each group tied within its error bars")
    ] = False,
    z: Annotated[
        float, typer.Option("--z", min=0.0, help="standard deviations of a difference within which points are tied")
    ] = pareto.Z,
) -> None:
    """The front over trusted points: a table, DIR/front.nc, and a figure."""
    dataset = store.open_study(directory)
    objectives = json.loads(dataset.attrs["objectives"])
    chosen = pareto.front(dataset, objectives)
    tied = ~pareto.significant(dataset, objectives, chosen, z)
    note = report.ties_note(dataset, objectives, chosen, tied, z)
    if significant:
        chosen, tied = chosen[~tied], tied[~tied]
    say(report.front_table(dataset, objectives, chosen, tied, pareto.best(dataset, objectives), Console()))
    if not chosen.size:
        return
    say(note)
    dim = "design" if "environment" in dataset.dims else "point"
    front = dataset.isel({dim: chosen}).assign(tied=(dim, tied, {"long_name": note.replace("\n", "; "), "z": z}))
    path = store.write_whole(directory / "front.nc", lambda place: front.to_netcdf(place, engine="netcdf4"))
    say(f"\nfront   {path}\nfigure  {_plots().save_plot(directory, 'front')}")


@app.command(name="sensitivity")
def sensitivity_command(
    directory: Folder,
    metric: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="a metric, by default every objective; may be given again")
    ] = None,
) -> None:
    """Which variables matter: Sobol indices (`sampler: saltelli`), a screening (`morris`), or first-order indices of
    any random design; a table, DIR/sensitivity.nc, and a figure. Says what failed runs left out."""
    from .sensitivity import sensitivity_of
    from .signal_plots import save_sensitivity

    try:
        found = sensitivity_of(directory, metric or ())
    except ValueError as error:
        if isinstance(error, BAD_INPUT):
            raise
        raise store.StoreError(f"sensitivity: {error}") from error
    say(report.sensitivities(found, Console()))
    path = store.write_whole(directory / "sensitivity.nc", lambda place: found.to_netcdf(place, engine="netcdf4"))
    say(f"\nindices {path}\nfigure  {save_sensitivity(found, directory / 'figures' / 'sensitivity.png')}")


@app.command(name="audit")
def audit_command(
    directory: Folder,
    sample: Annotated[int, typer.Option(min=0, metavar="N", help="trusted designs beside the front, at random")] = 8,
    model: Annotated[str | None, typer.Option(help="line of the audit [the next costlier]")] = None,
    segments: Annotated[int | None, typer.Option(min=2, metavar="N", help="mesh of the audit")] = None,
    seed: Annotated[int, typer.Option(min=0, help="of the sample")] = 0,
) -> None:
    """Run the front and a sample again with the next costlier model: how far metrics, order and front may be believed.

    The study's rows stay as they are; DIR/audit has the audit's, DIR/audit.nc both. Under mpirun as `run`.
    """
    from . import audit

    wanted = audit.Wanted(sample=sample, seed=seed, model=model, segments=segments)

    def told(ended: audit.Ended) -> str:
        if ended.data is None:
            return f"interrupted by {ended.interrupted}: the same command goes on from here"
        return f"{report.audited(ended.data, Console())}\n\naudit      {directory / 'audit.nc'}"

    _on_ranks(lambda ranks: audit.audit(directory, wanted, ranks), told)


def _plots() -> Any:
    """The figures; matplotlib is imported only where one is drawn."""
    from . import plot

    return plot


@app.command()
def plot(
    directory: Folder,
    kind: Annotated[str, typer.Argument(help="a kind of figure, or `all` the quick ones")],
    point: Annotated[
        str | None, typer.Option(metavar="best|KEY", help="the point to show, in figures of one point")
    ] = None,
    over: Annotated[
        list[str] | None,
        typer.Option(metavar="KEY", help="profile, compare: lay this point over it; may be given again"),
    ] = None,
) -> None:
    """Draw a figure into DIR/figures."""
    plots = _plots()
    if kind != "all" and kind not in plots.PLOTS:
        raise typer.BadParameter(f"{kind!r} is not one of: all, {', '.join(plots.PLOTS)}", param_hint="KIND")
    store.study_of(directory)
    cheap = [name for name, entry in plots.PLOTS.items() if not entry.dear]
    if kind == "all" and (point or over):
        raise typer.BadParameter("`all` shows the best point: name one kind of figure", param_hint="--point, --over")
    dataset = store.open_study(directory) if point or over else None
    key, others = None, []
    if dataset is not None:
        key, others = _key(dataset, point) if point else None, [_key(dataset, text) for text in over or ()]
    for name in cheap if kind == "all" else [kind]:
        try:
            say(plots.save_plot(directory, name, key, others))
        except ValueError as error:
            if kind != "all":
                raise store.StoreError(f"{name}: {error}") from error
            say(f"{name}: {error}")
