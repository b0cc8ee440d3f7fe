"""The options of the particle filters, each declared once with its type, default, choices and help.

Constructors take these options as keywords, and command lines and configuration files derive theirs from the fields.
This module imports neither the engine nor SciPy.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from graphslam.checks import check_choice
from graphslam.errors import OptionError, quoted

from .checks import finite, whole

#: how sightings are assigned to landmarks; auto stands for one of the others, which the log decides
ASSOCIATIONS = ("auto", "known", "maximum-likelihood")
#: what auto stands for where sightings have no ids: the most accurate on real logs, see docs/association.md
WITHOUT_IDS = "maximum-likelihood"
#: the stored poses of all particles are numbered with 32 bits
MOST_PARTICLES = 50_000_000
#: the names of the resampling schemes, see `fastslam.resampling`
RESAMPLING = ("systematic", "stratified", "residual", "multinomial")

#: how FastSLAM 2.0 weighs its particles: with the density of its proposal, or as if h and f were linear
PROPOSAL_WEIGHTS = ("exact", "linearised")
#: how the Gaussian of a landmark follows from its sightings: from each by the Kalman gain, or from all together
LANDMARK_UPDATES = ("kalman", "joint")
#: the range at which the variance of a sighting's range is taken
RANGE_NOISES = ("measured", "estimated")
#: the fewest trajectories that backward simulation draws, so that they have covariances
FEWEST_SMOOTHED = 10
#: how far the lectures' program has come: particles that only move, that are weighed, that are resampled
STAGES = ("motion", "weights", "resampling")


@dataclass(frozen=True, kw_only=True)
class FilterOptions:
    """The options of `MonteCarloLocalization`, `FastSLAM1` and `FastSLAM2`; each field's metadata has its help.

    With an ess_threshold of 1 the filter resamples after every weighted step, as in the lectures. The result does not
    depend on the number of threads. Monte Carlo localisation uses neither ``smoothing`` nor the options from
    ``association`` to ``range_noise``: it finds the landmarks of its map by their ids.

    Raises:
        OptionError: an option has an impossible value.
    """

    particles: int = field(default=1000, metadata={"help": "Number of particles N."})
    seed: int | np.random.Generator = field(
        default=0, metadata={"help": "Random seed; the same seed gives the same result."}
    )
    resampling: str = field(default="systematic", metadata={"help": "Resampling scheme.", "choices": RESAMPLING})
    ess_threshold: float = field(
        default=0.5, metadata={"help": "Resample when the effective sample size is at most this share of N."}
    )
    threads: int | None = field(default=None, metadata={"help": "Number of threads; by default all cores."})
    association: str = field(
        default="auto",
        metadata={
            "help": "Landmarks of sightings. Known takes their ids, maximum-likelihood the most likely landmark. "
            f"Auto is known, but {WITHOUT_IDS} where a log has no ids.",
            "choices": ASSOCIATIONS,
        },
    )
    new_landmark_threshold: float = field(
        default=1e-6, metadata={"help": "Probability that a sighting of a known landmark is taken for a new one."}
    )
    merge_interval: int = field(
        default=10,
        metadata={"help": "Merge landmarks that are one after every so many scans, 0: never; for unknown ids."},
    )
    class_confusion: float = field(
        default=0.05,
        metadata={
            "help": "Probability that the class of a sighting is wrong, where a log has classes; for unknown ids."
        },
    )

    proposal_weight: str = field(
        default="exact",
        metadata={
            "help": "Weight of FastSLAM 2.0: exact corrects its linearised proposal, linearised is that of the lectures.",
            "choices": PROPOSAL_WEIGHTS,
        },
    )
    landmark_update: str = field(
        default="kalman",
        metadata={
            "help": "Landmarks of FastSLAM: kalman linearises each sighting, joint integrates all sightings of a landmark "
            "together, with known ids only.",
            "choices": LANDMARK_UPDATES,
        },
    )
    range_noise: str = field(
        default="measured",
        metadata={
            "help": "FastSLAM takes the noise of the range at the measured range, or estimated, as in the slides; known "
            "ids only.",
            "choices": RANGE_NOISES,
        },
    )
    stage: str = field(
        default="resampling",
        metadata={
            "help": "Steps of a filter: motion neither weighs nor resamples, weights does not resample.",
            "choices": STAGES,
        },
    )
    smoothing: int = field(
        default=0,
        metadata={
            "help": "FastSLAM: trajectories drawn by backward simulation after the run, whose mean is reported; 0 for none, "
            "else at least 10; known ids only."
        },
    )

    def __post_init__(self) -> None:
        object.__setattr__(self, "particles", whole("particles", self.particles))
        if self.particles < 1:
            raise OptionError(f"particles must be at least 1, not {self.particles}")
        if self.particles > MOST_PARTICLES:
            raise OptionError(f"particles must be at most {MOST_PARTICLES}, not {self.particles}")
        if not isinstance(self.seed, np.random.Generator) and whole("seed", self.seed) < 0:
            raise OptionError(f"seed must be a whole number, not below 0, not {self.seed}")
        check_choice("resampling", self.resampling, RESAMPLING)
        check_choice("proposal_weight", self.proposal_weight, PROPOSAL_WEIGHTS)
        check_choice("association", self.association, ASSOCIATIONS)
        check_choice("landmark_update", self.landmark_update, LANDMARK_UPDATES)
        check_choice("range_noise", self.range_noise, RANGE_NOISES)
        check_choice("stage", self.stage, STAGES)
        object.__setattr__(self, "smoothing", whole("smoothing", self.smoothing))
        if self.smoothing < 0 or 0 < self.smoothing < FEWEST_SMOOTHED:
            raise OptionError(
                f"smoothing must be 0 (off) or at least {FEWEST_SMOOTHED} trajectories, not {self.smoothing}"
            )
        names = ("landmark_update", "range_noise", "smoothing")
        given = [name for name in names if getattr(self, name) != FilterOptions.__dataclass_fields__[name].default]
        if given and not self.uses_ids:
            raise OptionError(
                f"{given[0]} {getattr(self, given[0])} needs the association known, so ids of all sightings; with the "
                f"association {self.association}, which auto is where a log lacks ids, leave out {' and '.join(given)}"
            )
        if self.smoothing and self.stage == "motion":
            raise OptionError("smoothing needs weighted particles: the stage weights or resampling, not motion")
        if not 0 <= finite("ess_threshold", self.ess_threshold, "a number between 0 and 1", [()]) <= 1:
            raise OptionError(
                f"ess_threshold must lie between 0 (never resample) and 1 (always), not {quoted(self.ess_threshold)}"
            )
        for name in ("new_landmark_threshold", "class_confusion"):
            value = getattr(self, name)
            if not 0 < finite(name, value, "a number between 0 and 1", [()]) < 1:
                raise OptionError(f"{name} must lie between 0 and 1, not {quoted(value)}")
        object.__setattr__(self, "merge_interval", whole("merge_interval", self.merge_interval))
        if self.merge_interval < 0:
            raise OptionError(f"merge_interval must be a number of scans, or 0 for never, not {self.merge_interval}")
        expected = "a whole number of at least 1, or None for all"
        if self.threads is not None and whole("threads", self.threads, expected) < 1:
            raise OptionError(f"threads must be {expected}, not {quoted(self.threads)}")

    @property
    def uses_ids(self) -> bool:
        """Whether FastSLAM uses the landmark ids of the sightings, where they have any."""
        return self.association in ("auto", "known")

    def for_ids(self, identified: bool) -> FilterOptions:
        """These options with the association that auto stands for where sightings have ids or, else, have none."""
        if self.association != "auto":
            return self
        return replace(self, association="known" if identified else WITHOUT_IDS)


#: the density of the sightings that particle Gibbs samples
DENSITIES = ("linearised", "exact")


@dataclass(frozen=True, kw_only=True)
class GibbsOptions:
    """The options of `ParticleGibbs`; each field's metadata has its help.

    Raises:
        OptionError: an option has an impossible value.
    """

    particles: int = field(
        default=50, metadata={"help": "Particle Gibbs: number of particles of each conditional SMC."}
    )
    iterations: int = field(default=200, metadata={"help": "Particle Gibbs: samples of each chain."})
    warm_up: int = field(default=100, metadata={"help": "Particle Gibbs: sweeps of each chain before its samples."})
    chains: int = field(default=4, metadata={"help": "Particle Gibbs: number of independent chains."})
    block: int = field(default=20, metadata={"help": "Particle Gibbs: poses that are renewed at once."})
    density: str = field(
        default="linearised",
        metadata={
            "help": "Particle Gibbs: density of the sightings; exact corrects their linearisation by Metropolis steps.",
            "choices": DENSITIES,
        },
    )
    degrees_of_freedom: float | None = field(
        default=None,
        metadata={
            "help": "Particle Gibbs: degrees of freedom of Student's t distribution of the sightings, such as 4 for real "
            "data with wrong sightings; by default they are Gaussian."
        },
    )

    def __post_init__(self) -> None:
        for name, least in (("particles", 2), ("iterations", 1), ("warm_up", 0), ("chains", 1), ("block", 1)):
            value = whole(name, getattr(self, name))
            if value < least:
                raise OptionError(f"{name} must be at least {least}, not {value}")
            object.__setattr__(self, name, value)
        check_choice("density", self.density, DENSITIES)
        if self.degrees_of_freedom is not None:
            expected = "a number above 0, or None for Gaussian sightings"
            degrees = float(finite("degrees_of_freedom", self.degrees_of_freedom, expected, [()]))
            if degrees <= 0:
                raise OptionError(f"degrees_of_freedom must be {expected}, not {quoted(degrees)}")
            object.__setattr__(self, "degrees_of_freedom", degrees)
