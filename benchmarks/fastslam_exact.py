"""Do the particles mean what they say? FastSLAM and particle Gibbs against posteriors that are known otherwise.

    python benchmarks/fastslam_exact.py small [--logs 5]     # importance sampling: errors and slopes
    python benchmarks/fastslam_exact.py worlds [--logs 5]    # particle Gibbs against importance sampling
    python benchmarks/fastslam_exact.py long [--logs 10]     # particle Gibbs against a longer run of its own, 62 steps
    python benchmarks/fastslam_exact.py smoothing [--logs 3] # histories and backward simulation against the exact posterior
    python benchmarks/fastslam_exact.py calibration [--logs 200]     # ranks of the truth (simulation-based calibration)
    python benchmarks/fastslam_exact.py anees [--logs 50]    # ANEES per step at a tenth of the book's noise
    python benchmarks/fastslam_exact.py real [--seeds 20]    # MR.CLAM 6, noise by hand

The exact posterior has motions N(f(x, u), A M A' + epsilon I), sightings N(h(x, m), Q) with Q at the measured range, and flat
landmarks. Calibration: where the truth is drawn from the prior, its rank among posterior samples is uniform (Talts and
others, *Validating Bayesian inference algorithms with simulation-based calibration*, 2018). For this the range noise must
not depend on the range: with Q at the measured range the model has no proper density of the measurements.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path

import numpy as np
from scipy.special import gammaincc

from comparisons import study_consistency
from comparisons.datasets import data_folder
from fastslam import FastSLAM1, FastSLAM2, GibbsResult, ParticleGibbs
from graphslam import Graph, Log, MotionModel, SensorModel, load, simulate, solve
from graphslam.metrics import ate
from graphslam.se2 import Array, wrap

sys.path.append(str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "fastslam"))
sys.path.insert(0, str(Path(__file__).parent))
from error_rates import batch_errors
from exact_posterior import exact_posterior
from importance_sampling import importance
from real_filters import MOTION, SENSOR
from test_gibbs import small as small_log

FIFTH = {
    "motion": MotionModel(nn=0.038, no=0.0002, on=0.026, oo=0.04, epsilon=4e-6),
    "sensor": SensorModel(range_rate=0.028, bearing_std=0.01),
}
#: all draw motions from the Gaussian, the filters too: with one control and no offset f would not be linear;
#: columns of the sightings, offset of the sensor, several controls per motion
CASES = (
    (2, (0.0, 0.0), True),
    (3, (0.0, 0.0), True),
    (2, (0.3, 0.1), False),
    (3, (0.3, 0.1), False),
    (3, (0.3, 0.1), True),
)
#: densities of the sightings: name, whether exact, degrees of freedom of Student's t
DENSITIES = (
    ("linearised", False, None),
    ("exact", True, None),
    ("exact, Student's t with 4 degrees of freedom", True, 4.0),
)


def small(logs: int) -> Iterator[str]:
    """Errors of the means in standard deviations of the exact posterior: bias of ten runs at 60,000, and slopes."""
    sizes, repeats = (600, 6_000, 60_000), 10
    yield "| case | estimator | largest bias of any coordinate | largest ratio of standard deviations | slope |"
    yield "|---|---|---|---|---|"
    for case, (columns, offset, composite) in enumerate(CASES[:logs]):
        log, sensor = small_log(1, columns, offset, composite), SensorModel(offset=offset)
        gibbs = ParticleGibbs(
            log, seed=1, sensor=sensor, density="exact", particles=8, iterations=6000, warm_up=100, chains=2
        ).run()
        about = gibbs.trajectories[:, ::10].reshape(-1, 4, 3)
        reference = importance(log, sensor, MotionModel(), about, size=300_000, draws=4)
        # the last pose and the landmarks
        mean, std, size = reference.mean[6:], reference.std[6:], reference.size
        name = f"{columns} numbers{', offset' * (offset != (0.0, 0.0))}{', several controls' * composite}"
        found, spread = _of_gibbs(gibbs)
        yield (
            f"| {name} | particle Gibbs, exact, {np.nanmin(gibbs.mixing.ess):.0f} effective samples | "
            f"{np.abs((found - mean) / std).max():.3f} | {_ratio(spread / std):.2f} | - |"
        )
        for kind, update in product((FastSLAM1, FastSLAM2), ("kalman", "joint")):
            errors, options = [], {"sensor": sensor, "landmark_update": update}
            for n in sizes:
                runs = [_of_filter(kind(log, particles=n, seed=s, **options)) for s in range(repeats)]
                values = np.array([mean for mean, _ in runs])
                errors.append(np.sqrt(np.mean(values.var(axis=0, ddof=1) / std**2)))
            bias = np.abs((values.mean(axis=0) - mean) / std).max()
            ratio = _ratio(np.mean([s for _, s in runs], axis=0) / std)
            slope = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
            yield f"| {name} | {kind.__name__}, {update} | {bias:.3f} | {ratio:.2f} | {slope:.2f} |"
        yield f"(case {case + 1}: importance sampling with {size:.0f} effective samples)"


def worlds(logs: int) -> Iterator[str]:
    """Standard deviations of `ParticleGibbs` divided by those of importance sampling: both sensors, three densities.

    World k has 2 k landmarks, each seen from all of four poses with the book's noise. The linearised density is that of the
    sightings as measured, without a warm-up, which would linearise them again.
    """
    yield "| sensor | density | landmarks | poses | landmarks | largest standard error, both together | effective samples |"
    yield "|---|---|---|---|---|---|---|"
    farthest = 1.0
    for columns, (name, exact, degrees) in product((2, 3), DENSITIES):
        for world in range(1, logs + 1):
            log, chosen = small_log(world, columns, landmarks=2 * world), {"degrees_of_freedom": degrees}
            options = {"density": "exact", "warm_up": 100} if exact else {"density": "linearised", "warm_up": 0}
            result = ParticleGibbs(
                log, seed=world, motion=MotionModel(), particles=8, iterations=6000, chains=4, **options, **chosen
            ).run()
            about = result.trajectories[:, ::10].reshape(-1, 4, 3)
            reference = importance(
                log, SensorModel(), MotionModel(), about, size=60_000, draws=8, degrees=degrees, exact=exact
            )
            poses = np.diagonal(result.covariance()[1:], axis1=1, axis2=2)
            marks = [np.diag(C)[:2] for C in result.landmark_covariances.values()]
            ratios = np.sqrt(np.concatenate([poses.ravel(), *marks])) / reference.std
            pose_errors = batch_errors(result.deviations[..., :9])[1]
            error = np.hypot(pose_errors, reference.std_errors[:9]).max()
            farthest = max(farthest, _ratio(ratios[:9]), key=lambda ratio: abs(np.log(ratio)))
            yield (
                f"| {columns} numbers | {name} | {2 * world} | {ratios[:9].min():.3f} to {ratios[:9].max():.3f} | "
                f"{ratios[9:].min():.3f} to {ratios[9:].max():.3f} | {error:.3f} | {np.nanmin(result.mixing.ess):.0f} and "
                f"{reference.size:.0f} |"
            )
    yield f"farthest standard deviation of a pose: {farthest:.3f} times"


def _ratio(ratios: Array) -> float:
    """The ratio that is farthest from 1."""
    return float(ratios[np.argmax(np.abs(np.log(ratios)))])


def _of_gibbs(result: GibbsResult) -> tuple[Array, Array]:
    found = np.concatenate([result.poses[-1], *(m[:2] for m in result.landmarks.values())])
    variances = [np.diag(C)[:2] for C in result.landmark_covariances.values()]
    return found, np.sqrt(np.concatenate([np.diag(result.covariance()[-1]), *variances]))


def _of_filter(slam: FastSLAM1) -> tuple[Array, Array]:
    """Means and standard deviations of the last pose and the landmarks' positions."""
    slam.run()
    state, mixture = slam.state, slam.state.mixture_map()
    variances = [np.diag(state.covariance()), *(np.diag(mixture[j].covariance)[:2] for j in sorted(mixture))]
    means = [state.mean_pose, *(mixture[j].mean[:2] for j in sorted(mixture))]
    return np.concatenate(means), np.sqrt(np.concatenate(variances))


def long(logs: int) -> Iterator[str]:
    """Largest difference of any coordinate from a reference run with another seed and three times the sweeps."""
    met = 0
    for seed in range(logs):
        log = simulate(seed=seed, steps=62, clean=True, orientation=False, **FIFTH)
        begin = time.process_time()
        options = {"particles": 10, "warm_up": 200, "density": "exact", **FIFTH}
        run = ParticleGibbs(log, seed=seed, iterations=1200, **options).run()
        seconds = time.process_time() - begin
        reference = ParticleGibbs(log, seed=1000 + seed, iterations=3600, **options).run()
        means, spreads = [], []
        for result in (run, reference):
            maps = np.array(list(result.landmarks.values()))
            variances = np.array([np.diag(C) for C in result.landmark_covariances.values()])
            poses = np.diagonal(result.covariance()[1:], axis1=1, axis2=2)
            means.append((result.poses[1:], maps))
            spreads.append((np.sqrt(poses), np.sqrt(variances)))
        off = means[0][0] - means[1][0]
        off[:, 2] = wrap(off[:, 2])
        errors = np.concatenate([(off / spreads[1][0]).ravel(), ((means[0][1] - means[1][1]) / spreads[1][1]).ravel()])
        ratios = np.concatenate([(spreads[0][k] / spreads[1][k]).ravel() for k in (0, 1)])
        error, ratio = np.abs(errors).max(), _ratio(ratios)
        good = error < 0.1 and abs(ratio - 1) < 0.1
        met += good
        yield (
            f"log {seed}: largest error {error:.3f} standard deviations, standard deviations {ratio:.3f} times; "
            f"{run.mixing.statement}; {run.accepted:.0%} accepted; {seconds:.0f} s"
        )
    yield f"{met} of {logs} logs within 0.1 standard deviations and 10 %"


def smoothing(logs: int) -> Iterator[str]:
    """Root mean square error of the pose means, in standard deviations of the grown graph's posterior: three seeds each."""
    for seed in range(logs):
        log = simulate(seed=seed, steps=62, clean=True, orientation=False, **FIFTH)
        exact = exact_posterior(log, 62, FIFTH["motion"], FIFTH["sensor"])
        std = np.sqrt([np.diag(exact.pose_covariance(t)) for t in range(1, 63)])
        for kind, n in product((FastSLAM1, FastSLAM2), (1000, 10_000)):
            errors, ratios = [], []
            begin = time.process_time()
            for s in range(3):
                result = kind(log, particles=n, seed=s, smoothing=100, **FIFTH).run()
                assert result.smoothed is not None
                off = np.stack([result.mean_poses, result.smoothed.poses])[:, 1:] - exact.poses[1:]
                off[..., 2] = wrap(off[..., 2])
                errors.append(np.sqrt(np.mean((off / std) ** 2, axis=(1, 2))))
                found = np.sqrt(np.diagonal(result.smoothed.covariance()[1:], axis1=1, axis2=2))
                ratios.append(np.median(found / std))
            histories, drawn = np.mean(errors, axis=0)
            yield (
                f"log {seed}, {kind.__name__}, N = {n:,}: histories {histories:.2f}, drawn backwards {drawn:.2f}, their "
                f"standard deviations {np.median(ratios):.2f} times; {(time.process_time() - begin) / 3:.1f} s each"
            )


def calibration(logs: int) -> Iterator[str]:
    """Chi-square of the ranks of ten coordinates in ten bins, and the p value after Bonferroni's correction."""
    bins, samples = 10, 99
    ranks: dict[str, list[Array]] = {"particle Gibbs": [], "FastSLAM2": [], "FastSLAM1": []}
    for seed in range(logs):
        log, truth = _drawn(seed)
        rng = np.random.default_rng(seed)
        gibbs = ParticleGibbs(log, seed=seed, particles=8, iterations=495, warm_up=100, chains=2, density="exact").run()
        trajectories, maps = gibbs.trajectories[:, ::10].reshape(-1, 16, 3), gibbs.maps[:, ::10].reshape(-1, 4, 2)
        ranks["particle Gibbs"].append(_ranks(trajectories[:samples], maps[:samples], truth))
        for kind in (FastSLAM2, FastSLAM1):
            slam = kind(log, particles=2000, seed=seed)
            slam.run()
            chosen = rng.choice(2000, samples, p=np.exp(slam.state.log_weights))
            maps = []
            for i in chosen.tolist():
                marks = slam.state.map(i)
                maps.append([rng.multivariate_normal(marks[j].mean, marks[j].covariance) for j in sorted(marks)])
            trajectories = np.array([slam.trajectory(i) for i in chosen.tolist()])
            ranks[kind.__name__].append(_ranks(trajectories, np.array(maps), truth))
    yield "| estimator | smallest p of 10 coordinates | p after correction for 10 tests | chi-square of each (9 degrees) |"
    yield "|---|---|---|---|"
    for name, rows in ranks.items():
        counts = np.array([np.bincount(column * bins // (samples + 1), minlength=bins) for column in np.array(rows).T])
        chi2 = np.sum((counts - logs / bins) ** 2, axis=1) / (logs / bins)
        p = gammaincc((bins - 1) / 2, chi2 / 2)
        yield f"| {name} | {p.min():.4f} | {min(10 * p.min(), 1):.3f} | {' '.join(f'{c:.1f}' for c in chi2)} |"


def _drawn(seed: int) -> tuple[Log, Array]:
    """A log of 15 motions from the model itself, four landmarks always in view, and the ten true values."""
    rng, motion = np.random.default_rng(10_000 + seed), MotionModel()
    sensor = SensorModel.constant(0.3, 0.05)
    marks = rng.uniform(-8, 8, (4, 2))
    controls, dt = np.tile([0.3, 0.15], (15, 1)), np.full(15, 3.0)
    pose, poses, steps, ids, sightings = np.zeros(3), [np.zeros(3)], [], [], []
    motions, covariances = motion.accumulate(controls, dt, np.arange(16))
    for t in range(16):
        if t > 0:
            d = rng.multivariate_normal(motions[t - 1], covariances[t - 1])
            c, s = np.cos(pose[2]), np.sin(pose[2])
            pose = pose + [c * d[0] - s * d[1], s * d[0] + c * d[1], d[2]]
            poses.append(pose)
        for j in range(4):
            # a range below zero is no measurement
            z = np.array([-1.0, 0.0])
            while z[0] <= 0:
                z = sensor.h(pose, marks[j]) + np.sqrt(np.diag(sensor.Q([1.0, 0.0]))) * rng.standard_normal(2)
            steps, ids, sightings = [*steps, t], [*ids, j], [*sightings, z]
    log = Log(
        dt=dt,
        controls=controls,
        initial_poses=np.zeros((16, 3)),
        steps=steps,
        landmarks=ids,
        sightings=sightings,
        sensor=sensor,
        motion=motion,
    )
    return log, np.concatenate([poses[5], poses[15], marks[:2].ravel()])


def _ranks(trajectories: Array, maps: Array, truth: Array) -> Array:
    """Ranks of the true values among samples; headings by their differences."""
    values = np.hstack([trajectories[:, 5], trajectories[:, 15], maps[:, :2].reshape(len(maps), 4)])
    off = values - truth
    off[:, [2, 5]] = wrap(off[:, [2, 5]])
    return np.sum(off < 0, axis=0)


def anees(logs: int) -> Iterator[str]:
    """The verb ``consistency`` at a tenth of the noise."""
    for dimensions in (2, 3):
        study = study_consistency(logs=logs, noise=0.1, dimensions=dimensions, estimators=["particle-gibbs"], jobs=1)
        (result,) = study.results
        low, high = result.step_band
        yield (
            f"{dimensions} numbers, {result.logs} logs: ANEES / 3 per step {np.nanmedian(result.steps):.3f} in the median, "
            f"{result.steps.min():.2f} to {result.steps.max():.2f}, band {low:.2f} to {high:.2f}, "
            f"{result.steps_inside:.0%} of the steps inside"
        )


def real(seeds: int) -> Iterator[str]:
    """Median ATE over the seeds, as a ratio to that of the graph (Huber); particle Gibbs with at most five seeds."""
    for robot in (1, 3):
        log = load(data_folder() / "mrclam6", robot=robot).replace(motion=MOTION, sensor=SENSOR)
        truth = log.true_poses
        assert truth is not None
        graph, plain = (
            ate(truth, solve(Graph.from_log(log, edges="landmark+motion", kernel=kernel), initialize="auto").poses)
            for kernel in ("huber", "none")
        )
        yield f"robot {robot}, {log.num_poses} poses: graph with Huber's kernel {graph:.3f} m, without kernel {plain:.3f} m"
        found: dict[str, list[float]] = {"histories": [], "drawn backwards": []}
        begin = time.process_time()
        for seed in range(seeds):
            result = FastSLAM2(log, particles=500, seed=seed, smoothing=20).run()
            assert result.smoothed is not None
            found["histories"].append(ate(truth, result.mean_poses))
            found["drawn backwards"].append(ate(truth, result.smoothed.poses))
        seconds = (time.process_time() - begin) / seeds
        for name, values in found.items():
            yield f"FastSLAM 2.0, 500 particles, {name}: {_quartiles(values, graph)}; {seconds:.1f} s each, both together"
        for degrees in (None, 4.0):
            errors: list[float] = []
            statements = []
            begin, options = time.process_time(), {"particles": 5, "iterations": 60, "warm_up": 40, "chains": 2}
            for seed in range(min(seeds, 5)):
                samples = ParticleGibbs(log, seed=seed, degrees_of_freedom=degrees, **options).run()
                errors.append(ate(truth, samples.poses))
                statements.append(
                    f"R-hat {np.median(samples.mixing.rhat):.3f} in the median, {samples.mixing.statement}"
                )
            yield (
                f"particle Gibbs, {'Gaussian' if degrees is None else f'Student, {degrees:g} degrees'}: "
                f"{_quartiles(errors, graph)}; {(time.process_time() - begin) / len(statements):.1f} s each; {statements[0]}"
            )


def _quartiles(values: list[float], reference: float) -> str:
    low, median, high = np.quantile(values, [0.25, 0.5, 0.75])
    return f"{median:.3f} m ({low:.3f} to {high:.3f}), {median / reference:.2f} times"


def main() -> None:
    """Run one of the studies and print its lines."""
    studies: dict[str, tuple[Callable[[int], Iterator[str]], int]] = {
        "small": (small, 5),
        "worlds": (worlds, 5),
        "long": (long, 10),
        "smoothing": (smoothing, 3),
        "calibration": (calibration, 200),
        "anees": (anees, 50),
        "real": (real, 20),
    }
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("study", choices=studies)
    parser.add_argument("--logs", "--seeds", type=int)
    arguments = parser.parse_args()
    study, count = studies[arguments.study]
    for line in study(arguments.logs or count):
        print(line, flush=True)


if __name__ == "__main__":
    main()
