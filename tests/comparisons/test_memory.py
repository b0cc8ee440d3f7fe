"""The memory of a particle filter is forecast, and a run that cannot fit is refused before it starts."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import fastslam.options
from comparisons.estimators.filters import announce_memory
from comparisons.options import RunOptions
from comparisons.studies.sweep import study_particles, sweep
from fastslam import FastSLAM1, FilterOptions, MonteCarloLocalization
from fastslam.options import available_memory, forecast
from graphslam import Log, OptionError, SlamError, simulate
from graphslam.log import UNIDENTIFIED


@pytest.fixture(scope="module")
def log() -> Log:
    return simulate(seed=1, steps=20, clean=True)


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs the peak of memory that Linux tells")
def test_the_forecast_holds() -> None:
    # in a process of its own, because the peak of this one may be higher already; the peak that `resource` tells would be
    # that of the parent, too, but VmHWM begins anew with each program
    code = """
        import re
        from pathlib import Path
        from fastslam import FastSLAM1, FilterOptions
        from fastslam.options import forecast
        from graphslam import simulate
        def peak():
            return 1024 * int(re.search(r"VmHWM:\\s*(\\d+) kB", Path("/proc/self/status").read_text())[1])
        log = simulate(seed=1, steps=20, clean=True)
        FastSLAM1(log, particles=10, threads=1).run()
        before = peak()
        FastSLAM1(log, particles=60000, threads=1).run()
        used = peak() - before
        need = forecast(log, FilterOptions(particles=60000), maps=True)
        print(used / need.least, used / need.most)
    """
    lines = "\n".join(line[8:] for line in code.splitlines())
    done = subprocess.run([sys.executable, "-W", "ignore", "-c", lines], capture_output=True, text=True, check=True)
    above, below = map(float, done.stdout.split())
    assert above > 0.3
    assert below < 1.3


def test_the_forecast_grows_with_particles_maps_and_histories(log: Log) -> None:
    def most(maps: bool = True, **options: object) -> float:
        return forecast(log, FilterOptions(**options), maps=maps).most

    assert most(particles=2000) == 2 * most(particles=1000)
    assert most(maps=False) < most() < most(association="maximum-likelihood")
    assert most(ess_threshold=0.0) >= most()
    # a log without ids has as many landmarks
    hidden = log.replace(landmarks=np.full(len(log.steps), UNIDENTIFIED))
    without = forecast(hidden, FilterOptions(), maps=True).most
    assert without == pytest.approx(most(association="maximum-likelihood"), rel=0.02)
    assert str(forecast(log, FilterOptions(particles=10**6), maps=False)).endswith(" GB")


def test_what_cannot_fit_is_refused_before_it_starts(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    there = available_memory()
    assert there is None or there > 1e6
    with pytest.raises(OptionError, match="particles must be at most"):
        FastSLAM1(log, particles=10**11)
    monkeypatch.setattr(fastslam.options, "available_memory", lambda: 1e9)
    with pytest.raises(
        OptionError, match=r"2,000,000 particles on simulated need .* GB of memory, and 1 GB are available; take"
    ):
        FastSLAM1(log, particles=2_000_000)
    with pytest.raises(OptionError, match="GB are available"):
        MonteCarloLocalization(log, particles=20_000_000)
    with pytest.raises(SlamError, match="no run has a result: .* GB are available"):
        study_particles(log, particles=(2_000_000,), seeds=1, jobs=0)


def test_much_memory_is_announced(log: Log, monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    monkeypatch.setattr("comparisons.estimators.filters.available_memory", lambda: 10e9)
    large = RunOptions.of(particles=1_000_000)
    announce_memory([("graph", log, large), ("fastslam1", log, RunOptions.of())], said.append)
    assert said == []
    announce_memory([("fastslam1", log, large)] * 2, said.append, jobs=8)
    assert said[0].startswith("fastslam1 with 1,000,000 particles on simulated needs ")
    assert said[0].endswith("GB of memory, and 2 runs are executed at a time.")
    with pytest.raises(
        OptionError, match="8 runs at a time need more than the 10 GB that are available; use --jobs [1-7]"
    ):
        announce_memory([("fastslam1", log, large)] * 8, said.append, jobs=8)


def test_a_sweep_says_what_its_largest_run_needs(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    study = tmp_path / "study.toml"
    study.write_text(
        'estimators = ["fastslam1"]\nseeds = 2\n[simulate]\nsteps = 3\nlandmarks = 2\n[options]\nparticles = 3000000\n'
    )
    said: list[str] = []
    monkeypatch.setattr("fastslam.options.available_memory", lambda: 1e9)
    assert sweep(study, jobs=0, announce=said.append).failed == 2
    assert said[0].startswith("fastslam1 with 3,000,000 particles on book needs")
    monkeypatch.setattr("comparisons.estimators.filters.available_memory", lambda: 2.5e9)
    with pytest.raises(OptionError, match="2 runs at a time .* use --jobs 1"):
        sweep(study, jobs=2, retry=True)
