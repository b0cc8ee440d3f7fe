"""Wrong sightings: what they do to each weight and kernel, and what graduated non-convexity makes of it.

    python benchmarks/phantoms.py --seeds 50 --part 0.1

Simulated logs whose noise follows the model, 3-D sensor, a part of the sightings replaced by random ones (range 0.5 to
6 m, bearing within the field of view, any orientation). Median and worst ATE over the seeds, as a ratio to the clean
log solved without any defence.
"""

from __future__ import annotations

import argparse
from collections import defaultdict

import numpy as np

from graphslam import Graph, GraphError, Log, simulate, solve
from graphslam.metrics import ate

VARIANTS = [{"weight": weight} for weight in ("pairs", "tempered", "marginal")] + [{"edges": "landmark+motion"}]
KERNELS = ("none", "huber", "cauchy", "geman-mcclure")


def with_phantoms(log: Log, part: float, rng: np.random.Generator) -> tuple[Log, np.ndarray]:
    """The log with a part of its sightings replaced, and which."""
    sightings, count = log.sightings.copy(), len(log.sightings)
    wrong = rng.choice(count, round(part * count), replace=False)
    sightings[wrong, 0] = rng.uniform(0.5, 6, len(wrong))
    sightings[wrong, 1] = rng.uniform(-np.pi / 3, np.pi / 3, len(wrong))
    sightings[wrong, 2] = rng.uniform(-np.pi, np.pi, len(wrong))
    return log.replace(sightings=sightings), wrong


def main() -> None:
    """Run the study and print its table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--part", type=float, default=0.1)
    options = parser.parse_args()
    errors: dict[tuple[str, str], list[float]] = defaultdict(list)
    missed: dict[str, list[float]] = defaultdict(list)
    refused: dict[str, list[float]] = defaultdict(list)
    for seed in range(options.seeds):
        log = simulate(seed=seed, clean=True)
        bad, wrong = with_phantoms(log, options.part, np.random.default_rng(1000 + seed))
        assert log.true_poses is not None
        for variant in VARIANTS:
            name = variant.get("weight", "landmark nodes")
            clean = solve(Graph.from_log(log, **variant), initialize="auto")
            errors[name, "clean"].append(ate(log.true_poses, clean.poses))
            for kernel in KERNELS:
                try:
                    poses = solve(Graph.from_log(bad, **variant, kernel=kernel), initialize="auto").poses
                    errors[name, kernel].append(ate(log.true_poses, poses))
                except GraphError:
                    errors[name, kernel].append(np.inf)
            robust = solve(Graph.from_log(bad, **variant), method="gnc")
            errors[name, "gnc"].append(ate(log.true_poses, robust.poses))
            assert robust.trust is not None
            right = np.delete(robust.trust, wrong)
            missed[name].append(float(np.mean(robust.trust[wrong] > 0.5)))
            refused[name].append(float(np.mean(right < 0.5)))
    print(f"{'':16}{'':16}{'median ATE':>12}{'worst':>8}{'/ clean':>9}")
    for (name, kind), found in errors.items():
        median, base = np.median(found), np.median(errors[name, "clean"])
        print(f"{name:16}{kind:16}{median:10.3f} m{max(found):8.2f}{median / base:9.2f}")
    for name, found in missed.items():
        print(
            f"{name}: gnc missed {np.mean(found):.1%} of the phantoms, refused {np.mean(refused[name]):.1%} of the others"
        )


if __name__ == "__main__":
    main()
