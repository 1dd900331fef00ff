"""Scripts, sites and limits, without a SLURM: what is submitted on a real one is in tests/slurm."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import fakes
import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from sweep import cli, locks, run, submit
from sweep.config import parse_study
from sweep.mistakes import ConfigError
from sweep.plan import read_plan
from sweep.store import DiskStore, Replay, StoreError, prepare
from sweep.submit import Request, Site, load_site, plan_costs, render, scripts
from sweep.supervise import CannotRun

ROOT = Path(__file__).resolve().parents[2]
TINY = Path(__file__).with_name("tiny.yaml")
STUDY = yaml.safe_load(TINY.read_text().replace("n: 6,", "n: 12,"))


def headers(text: str) -> dict[str, str]:
    lines = [line.split()[1] for line in text.splitlines() if line.startswith("#SBATCH --")]
    return {name[2:]: value for name, _, value in (line.partition("=") for line in lines)}


@pytest.mark.parametrize("name", ["array", "mpi", "optimise", "merge"])
def test_scripts_are_good_bash_and_carry_the_sites_options(tmp_path, name):
    options = {"partition": "long", "time": "12:00:00", "exclusive": True, "mem-per-cpu": None}
    site = Site(options=options, setup=("module load x",), node_cache=True, launch="srun --mpi=pmix")
    text = render(name, site, site.options)
    found = headers(text)
    assert found["partition"] == "long"
    assert found["time"] == "12:00:00"
    assert found["exclusive"] == ""
    assert "mem-per-cpu" not in found
    assert "module load x" in text.splitlines()
    assert 'export CABLE_SWEEP_CACHE="${TMPDIR:-/tmp}/cable-sweep-$(id -un)"' in text.splitlines()
    assert "LAUNCH='srun --mpi=pmix'" in text.splitlines()
    assert ".venv" not in text
    for script in (text, (ROOT / f"slurm/{name}.sbatch").read_text()):
        assert subprocess.run(["bash", "-n"], input=script, text=True, check=False).returncode == 0


def test_command_line_wins_and_a_large_array_is_split():
    site = Site(options={"time": "04:00:00", "partition": "short"})
    request = Request(array=25, options={"partition": "long"}, extra=["--retry=failed"])
    made = scripts("my study", Path("/results/a b"), request, site, limit=10)
    assert [script.name for script in made] == ["array", "array", "array", "merge"]
    assert [script.options[0] for script in made[:3]] == ["--array=0-9", "--array=0-9", "--array=0-4"]
    assert [script.options[1].split(",", 1)[1] for script in made[:3]] == [
        f"SWEEP_FIRST={first},SWEEP_OF=25" for first in (0, 10, 20)
    ]
    assert made[0].words == ["/results/a b/study.yaml", "/results/a b", "--retry=failed"]
    assert headers(made[0].text)["partition"] == "long"
    assert '--output="/results/a b/logs/%x-%A_%a.log"' in made[0].text
    assert headers(made[0].text)["job-name"] == "my-study"
    assert made[-1].options[0] == "--dependency=afterany:{jobs}"


def test_a_search_is_one_job_of_ranks_and_a_merge(tmp_path):
    out = tmp_path / "out"
    words = ["submit", str(TINY), "--out", str(out), "--optimise", "--evaluations", "40", "--dry-run"]
    said = CliRunner().invoke(cli.app, [*words, "--ranks", "3"])
    assert said.exit_code == 0, said.output
    assert f"optimise.sbatch {out}/study.yaml {out} --evaluations=40" in said.output
    assert "--ntasks=3" in said.output
    assert '-m sweep optimise "$study" --out "$folder"' in said.output
    assert "merge.sbatch" in said.output
    assert not out.exists()
    for wrong in (["--array", "3"], ["--ranks", "3", "--limit", "5"], ["--ranks", "3", "--retry", "failed"]):
        refused = CliRunner().invoke(cli.app, [*words, *wrong])
        assert (refused.exit_code, "generation" in refused.output) == (2, True), refused.output


def test_every_mistake_of_a_site_is_said_at_once(tmp_path):
    path = tmp_path / "site.yaml"
    path.write_text("options: {time: 12:00:00, -p: short, array: 0-3, account: a b}\n")
    with pytest.raises(ConfigError) as caught:
        load_site(path)
    said = str(caught.value)
    for word in ("options.time", "in quotes", "options.-p", "options.array", "options.account"):
        assert word in said
    path.write_text("lunch: srun\n")
    with pytest.raises(ConfigError, match="launch"):
        load_site(path)
    assert load_site(ROOT / "slurm/site.yaml").launch == Site().launch == "mpirun"


def test_files_are_counted_by_tasks(tmp_path, monkeypatch):
    submit._room(tmp_path, 1000, Site())
    with pytest.raises(StoreError, match=r"1000 tasks make up to 3012 files, and site.yaml allows 3000 more"):
        submit._room(tmp_path, 1000, Site(max_files=3000))
    monkeypatch.setattr(submit.os, "statvfs", lambda path: os.statvfs_result((0,) * 5 + (100, 20, 20, 0, 0)))
    with pytest.raises(StoreError, match="has room for 20 more"):
        submit._room(tmp_path, 10, Site())


def test_without_slurm_it_is_said(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(StoreError, match="--dry-run"):
        submit.submit(parse_study(STUDY), run.Settings(directory=tmp_path), Request(array=2), Site())


def test_a_dry_run_writes_nothing(tmp_path, monkeypatch):
    out = tmp_path / "out"
    said = submit.submit(parse_study(STUDY), run.Settings(directory=out), Request(ranks=3), Site(), dry_run=True)
    assert "sbatch --parsable --ntasks=3" in "\n".join(said)
    assert not out.exists()


def test_costs_come_from_rows_and_done_points_cost_nothing(tmp_path):
    """Work doubles from each design to the next but one; slices by the plan's costs are even, by count they are not."""
    study = parse_study(STUDY)
    settings = run.Settings(directory=tmp_path, evaluator=f"{fakes.HERE}:costly", warm_ups=())
    plan, left, pace = plan_costs(study, settings, pilots=6)
    assert left == 6
    assert np.count_nonzero(plan.costs) == 6
    assert pace > 0
    assert read_plan(tmp_path / "plan.json").costs == pytest.approx(plan.costs, rel=1e-5)
    shared = [plan.slice(k, 3) for k in range(3)]
    assert sum(len(run.to_do(places, Replay(tmp_path, plan.keys))) for places in shared) == 6
    loads = [float(plan.costs[places].sum()) for places in shared]
    by_count = [float(plan.costs[k::3].sum()) for k in range(3)]
    assert max(loads) < max(by_count)
    assert sorted(i for places in shared for i in places) == list(range(12))


def test_a_job_that_makes_no_progress_is_not_requeued_for_ever(tmp_path, monkeypatch):
    study = parse_study(STUDY)
    settings = run.Settings(directory=tmp_path, evaluator=f"{fakes.HERE}:planned", warm_ups=(), part=(0, 2))
    once = DiskStore(tmp_path, "part0of2-9", run.provenance(study))  # of a rank that there was in an earlier run
    once.append(replace(fakes.evaluate(fakes.make(0)), key="0" * 16))
    once.close()
    for _ in range(run.FRUITLESS):
        part = DiskStore(tmp_path, "part0of2-0", run.provenance(study))
        part.open()
        part.close()
    monkeypatch.setenv("SLURM_RESTART_COUNT", "3")
    with pytest.raises(CannotRun, match="turns in a row ended before any point did"):
        run.run(study, settings)
    monkeypatch.setenv("SLURM_RESTART_COUNT", "0")
    assert run.run(study, settings).exit_code == 0
    monkeypatch.setenv("SLURM_RESTART_COUNT", "3")
    assert run.run(study, replace(settings, part=(1, 2))).results is not None  # the last slice makes the file


def test_a_requeued_job_retries_nothing_that_it_has_done(tmp_path, monkeypatch):
    """Else a point that fails each time would be run in every turn, and the study might never end."""
    study = parse_study(STUDY)
    monkeypatch.setenv("FAKE_MODES", "raise,good")
    settings = run.Settings(directory=tmp_path, evaluator=f"{fakes.HERE}:planned", warm_ups=())
    assert run.run(study, settings).exit_code == 1
    retry = replace(settings, retry=frozenset({"failed"}))
    monkeypatch.setenv("SLURM_JOB_ID", "17")
    assert run.run(study, retry).before == 6  # the job's first turn runs the failed ones again
    monkeypatch.setenv("SLURM_RESTART_COUNT", "1")
    assert run.run(study, retry).before == 12
    monkeypatch.setenv("SLURM_JOB_ID", "18")
    monkeypatch.setenv("SLURM_RESTART_COUNT", "0")
    assert run.run(study, retry).before == 6  # submitted again, by the user's will


def test_a_job_that_never_begins_is_not_requeued_for_ever(tmp_path, monkeypatch):
    """A launcher that fails leaves no trace but the count of restarts; `status --missing` is what the script asks."""
    study = parse_study(STUDY)
    settings = run.Settings(directory=tmp_path, evaluator=f"{fakes.HERE}:planned", warm_ups=(), limit=3)
    assert run.run(study, settings).exit_code == 0
    words = ["status", str(tmp_path), "--missing"]
    assert CliRunner().invoke(cli.app, words).exit_code == 0
    assert run.run(study, replace(settings, limit=None, part=(0, 2))).exit_code == 0
    assert CliRunner().invoke(cli.app, words).exit_code == 3
    monkeypatch.setenv("SLURM_JOB_ID", "17")
    monkeypatch.setenv("SLURM_RESTART_COUNT", "3")
    with pytest.raises(CannotRun, match="job 17 was started 4 times and never began to write"):
        CliRunner().invoke(cli.app, words, catch_exceptions=False)
    with pytest.raises(CannotRun, match="never began to write"):
        run.run(study, settings)


def test_slices_with_and_without_a_limit_do_not_work_side_by_side(tmp_path):
    """They would cut the study differently, and run points twice."""
    study = parse_study(STUDY)
    settings = run.Settings(directory=tmp_path, evaluator=f"{fakes.HERE}:planned", warm_ups=(), part=(0, 2))
    limited = locks.acquire(tmp_path, "part1of2", run.lock_digest(run.provenance(study), replace(settings, limit=3)))
    with pytest.raises(locks.Busy, match="--limit"):
        run.run(study, settings)
    limited.release()
    assert run.run(study, settings).planned == 6


def test_a_signal_before_the_first_point_ends_a_run_in_good_order(tmp_path, monkeypatch):
    """While journals are read, say: the next turn begins as if nothing had been."""
    study = parse_study(STUDY)
    settings = run.Settings(directory=tmp_path, evaluator=f"{fakes.HERE}:planned", warm_ups=())
    prepare = run.prepare

    def told(*words):
        os.kill(os.getpid(), signal.SIGUSR1)
        return prepare(*words)

    monkeypatch.setattr(run, "prepare", told)
    ended = run.run(study, settings)
    assert (ended.exit_code, ended.interrupted, ended.results) == (3, "SIGUSR1", None)
    assert list((tmp_path / "locks").iterdir()) == []
    monkeypatch.setattr(run, "prepare", prepare)
    merge = run.merge

    def told_late(*words):
        os.kill(os.getpid(), signal.SIGTERM)
        return merge(*words)

    monkeypatch.setattr(run, "merge", told_late)
    ended = run.run(study, settings)
    assert (ended.exit_code, ended.results) == (0, tmp_path / "results.nc")  # the file is made all the same


def test_a_million_failures_with_numbers_of_their_own_are_one_line(tmp_path):
    study = parse_study(STUDY)
    plan = prepare(study, tmp_path)
    part = DiskStore(tmp_path, "0", {"solver": "a"})
    for i in range(len(plan)):
        row = fakes.evaluate(fakes.make(i))
        part.append(replace(row, key=plan.keys[i], status="DIVERGED", message=f"diverged at t = 0.{i + 1}"))
    part.close()
    assert run.tally(Replay(tmp_path, plan.keys), plan.slice(0, 1)) == {("DIVERGED", "diverged at t = 0.1"): 12}


def test_a_log_on_a_full_disk_does_not_change_the_exit_code():
    with open("/dev/full", "w") as full:
        ended = subprocess.run([sys.executable, "-m", "sweep", "metrics"], stdout=full, cwd=ROOT, check=False)
    assert ended.returncode == 0


def test_torn_lines_of_the_list_of_jobs_are_passed_over(tmp_path, monkeypatch):
    (tmp_path / "jobs").mkdir()
    (tmp_path / "jobs" / "submitted.jsonl").write_text('{"job": "17", "kind": "array"}\n{"job": "1')
    (tmp_path / "squeue").write_text("#!/bin/sh\necho 17\n")
    (tmp_path / "squeue").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    with pytest.raises(locks.Busy, match="jobs 17 of"):
        submit._not_queued(tmp_path)


# ------------------------------------------------------------------------------------------ compiled kernels


def _cache(**environment: str) -> str:
    known = {k: v for k, v in os.environ.items() if k not in ("CABLE_SWEEP_CACHE", "NUMBA_CACHE_DIR", "XDG_CACHE_HOME")}
    code = "import solvers, numba; assert numba.config.CACHE_DIR == solvers.CACHE; print(solvers.CACHE)"
    command = [sys.executable, "-c", code]
    return subprocess.run(command, capture_output=True, text=True, check=True, env=known | environment).stdout.strip()


def test_a_cache_folder_that_is_set_is_respected(tmp_path):
    """Never without the sources' hash: numba would serve old physics."""
    name = f"cable-sweep/numba-{run.SOURCE_HASH}"
    assert _cache(NUMBA_CACHE_DIR=str(tmp_path)) == str(tmp_path / name)
    assert _cache(NUMBA_CACHE_DIR="/nowhere", CABLE_SWEEP_CACHE=str(tmp_path)) == str(tmp_path / name)
    assert _cache() == str(Path.home() / ".cache" / name)


def test_kernels_of_old_versions_are_removed(tmp_path, monkeypatch):
    monkeypatch.setattr(run, "CACHE", str(tmp_path / "numba-mine"))
    for name, days in (("numba-old", 15), ("numba-young", 13), ("numba-mine", 99), ("other", 99)):
        (tmp_path / name / "lumped").mkdir(parents=True)
        (tmp_path / name / "lumped" / "kernel.nbi").touch()
        then = time.time() - days * 86400
        os.utime(tmp_path / name, (then, then))
    assert [path.name for path in run.clean_caches()] == ["numba-old"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["numba-mine", "numba-young", "other"]
    assert time.time() - (tmp_path / "numba-mine").stat().st_mtime < 60
