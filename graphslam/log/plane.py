"""Latitude and longitude as places in the plane that touches the earth at the first of them (WGS 84)."""

from __future__ import annotations

import numpy as np

from ..se2 import Array

#: the major half-axis [m] and the squared eccentricity of the ellipsoid
_AXIS, _ECCENTRICITY = 6378137.0, 6.69437999014e-3


def local_plane(fixes: Array, datum: Array, height: float = 0.0) -> Array:
    """East and north (N, 2) [m] of fixes (N, 2), latitude and longitude [degrees], in the plane that touches at the datum."""

    def earth(latitude: Array, longitude: Array) -> Array:
        N = _AXIS / np.sqrt(1 - _ECCENTRICITY * np.sin(latitude) ** 2)
        along = (N + height) * np.cos(latitude)
        up = (N * (1 - _ECCENTRICITY) + height) * np.sin(latitude)
        return np.stack([along * np.cos(longitude), along * np.sin(longitude), up], axis=-1)

    phi, lam = np.radians(datum)
    axes = np.array([
        [-np.sin(lam), np.cos(lam), 0.0],
        [-np.sin(phi) * np.cos(lam), -np.sin(phi) * np.sin(lam), np.cos(phi)],
    ])  # fmt: skip
    return np.asarray((earth(*np.radians(fixes).T) - earth(phi, lam)) @ axes.T)


def datum_note(datum: Array, source: str) -> str:
    """The sentence about the origin of the plane."""
    return (
        f"positions are metres east and north of latitude {datum[0]:.8f}, longitude {datum[1]:.8f} degrees (WGS 84), the "
        f"first fix of {source}"
    )
