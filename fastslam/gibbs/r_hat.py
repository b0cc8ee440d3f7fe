"""Whether chains have mixed: split R-hat and the effective sample size, of all coordinates at once.

Sources: Vehtari, Gelman, Simpson, Carpenter and Bürkner, *Rank-normalization, folding, and localization: an improved
R-hat*, Bayesian Analysis 2021 (here without ranks: the coordinates are nearly Gaussian); Geyer, *Practical Markov chain
Monte Carlo*, Statistical Science 1992, for where the sum of autocovariances ends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from graphslam.se2 import Array

#: a larger R-hat, or fewer effective samples, and the chains have not mixed
LARGEST_RHAT, LEAST_ESS = 1.05, 100.0
#: from this R-hat on, chains are still on their way from where they began, and neither more samples nor more particles help
APART = 2.0


@dataclass(frozen=True, eq=False)
class Mixing:
    """R-hat and effective sample size of chains, by coordinate.

    Attributes:
        names: of the coordinates.
        rhat: potential scale reduction of the split chains; 1 means mixed; NaN for a coordinate that never changes.
        ess: effective number of independent samples for the mean.
    """

    names: list[str]
    rhat: Array
    ess: Array

    @property
    def mixed(self) -> bool:
        """Whether every coordinate has mixed."""
        return bool(np.nanmax(self.rhat, initial=1.0) <= LARGEST_RHAT and np.nanmin(self.ess) >= LEAST_ESS)

    @property
    def statement(self) -> str:
        """One sentence: the worst coordinates and, where the chains have not mixed, what to raise."""
        worst, least = int(np.nanargmax(self.rhat)), int(np.nanargmin(self.ess))
        figures = (
            f"R-hat at most {self.rhat[worst]:.3f} ({self.names[worst]}), effective sample size at least "
            f"{self.ess[least]:.0f} ({self.names[least]})"
        )
        if self.mixed:
            return f"mixed: {figures}"
        if APART < self.rhat[worst] < np.inf:
            advice = (
                "the chains are still far apart: raise warm_up, to thousands where the sensor is far more precise than the "
                "odometry"
            )
        else:
            raised = "iterations and warm_up" if self.rhat[worst] > LARGEST_RHAT else "iterations"
            advice = f"raise {raised}, and if that does not help, particles"
        return (
            f"not mixed: {figures}, but R-hat should be at most {LARGEST_RHAT} and the effective sample size at least "
            f"{LEAST_ESS:.0f}; {advice}"
        )


def judge(samples: Array, names: list[str]) -> Mixing:
    """Return R-hat and effective sample size of samples (chains, sweeps, coordinates), each chain split in two halves.

    Where chains are shorter than four sweeps, or nothing ever changes, R-hat is infinite and the effective sample size 0.
    """
    half = samples.shape[1] // 2
    if half < 2 or np.all(samples == samples[:1, :1]):
        return Mixing(names, np.full(samples.shape[2], np.inf), np.zeros(samples.shape[2]))
    halves = np.concatenate([samples[:, :half], samples[:, half : 2 * half]])
    mean = halves.mean(axis=1, keepdims=True)
    within = halves.var(axis=1, ddof=1).mean(axis=0)
    variance = within * (half - 1) / half + mean[:, 0].var(axis=0, ddof=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        rhat = np.sqrt(variance / within)
        # autocovariances by Fourier transform, a bounded number of coordinates at a time
        rho = np.empty((half, samples.shape[2]))
        for k in range(0, samples.shape[2], 256):
            d = halves[..., k : k + 256] - mean[..., k : k + 256]
            spectrum = np.abs(np.fft.rfft(d, 2 * half, axis=1)) ** 2
            covariance = np.fft.irfft(spectrum, axis=1)[:, :half].mean(axis=0) / half
            scale = variance[k : k + 256]
            rho[:, k : k + 256] = 1 - (within[k : k + 256] - covariance * half / (half - 1)) / scale
        rho[0] = 1
        pairs = rho[: half // 2 * 2].reshape(-1, 2, samples.shape[2]).sum(axis=1)
        # the sum ends where a pair is negative, and never rises again
        pairs[np.cumsum(pairs < 0, axis=0) > 0] = 0.0
        tau = np.maximum(2 * np.minimum.accumulate(pairs, axis=0).sum(axis=0) - 1, 1 / np.log10(len(halves) * half))
        ess = np.where(variance > 0, len(halves) * half / tau, np.nan)
    return Mixing(names, rhat, ess)
