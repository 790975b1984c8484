"""What a beam does at a pane: it returns from it, is mirrored, or passes through.

A beam that is split returns the stronger echo. A ray cannot be split, so it is mirrored with the
chance that the mirrored echo is the stronger one if both sides of the pane look alike: R² against
T², because the beam meets the pane twice.

Sources: Fresnel's equations for unpolarised light; refractive index 1.52 of soda-lime glass
(EN 572-1: 1.50); 6 mm of clear float transmit 0.8 to 0.9 of the near infrared (EN 410); coatings
reflect 0.2 to 0.5 of it. Panes are visible in scans within a few degrees of normal incidence
(Foster, Sun, Park, Kuipers: VisAGGE, ICRA 2013).
"""

from enum import IntEnum

import numpy as np

from ffmap.algorithms.base.scan import BoolArray, FloatArray, UInt8Array

_INDEX = 1.52


class Glass(IntEnum):
    """Kinds of panes; 0 in a mesh is no pane."""

    CLEAR = 1
    DOUBLE = 2
    COATED = 3
    FROSTED = 4
    MIRROR = 5


_OPTICS = np.array(
    [
        (1, 1.0, 0.0, 0.0, 0.0, 1.0),
        (1, 0.88, 0.0, 0.01, 0.6, 2.0),
        (2, 0.88, 0.0, 0.02, 0.8, 2.0),
        (2, 0.70, 0.35, 0.03, 1.0, 4.0),
        (1, 0.80, 0.0, 0.75, 0.35, 4.0),
        (1, 0.0, 0.88, 0.01, 1.0, 2.0),
    ],
    [(name, float) for name in ("sheets", "through", "coating", "scattered", "echo", "glint_deg")],
)
"""By code of `Glass`: number of sheets; transmission of a sheet at normal incidence; share that a
coating reflects; chance that dust or a rough surface returns the beam at any angle, and strength of
this echo; angle from normal incidence within which the mirrored beam meets the sensor."""


def reflectance(pane: UInt8Array, cosine: FloatArray) -> FloatArray:
    """Return the share (n,) of light mirrored by panes (n,) at cosines of incidence (n,)."""
    optics, inside = _OPTICS[pane], _inside(cosine)
    faces = 2 * optics["sheets"]
    across = ((cosine - _INDEX * inside) / (cosine + _INDEX * inside)) ** 2
    along = ((inside - _INDEX * cosine) / (inside + _INDEX * cosine)) ** 2
    # Light that is reflected back and forth between the faces adds up (Stokes).
    bare = 0.5 * sum(faces * one / (1.0 + (faces - 1) * one) for one in (across, along))
    return np.asarray(bare + optics["coating"] * (1.0 - bare))


def transmittance(pane: UInt8Array, cosine: FloatArray) -> FloatArray:
    """Return the share (n,) of light transmitted."""
    optics = _OPTICS[pane]
    passed = optics["through"] ** (optics["sheets"] / _inside(cosine))
    return np.asarray((1.0 - reflectance(pane, cosine)) * passed)


def returns(pane: UInt8Array, cosine: FloatArray) -> FloatArray:
    """Return the chance (n,) that panes return the beam themselves."""
    optics, off_deg = _OPTICS[pane], np.degrees(np.arccos(np.clip(cosine, 0.0, 1.0)))
    glint = 0.9 * np.clip(2.0 - off_deg / optics["glint_deg"], 0.0, 1.0)
    return np.asarray(np.maximum(optics["scattered"], glint))


def echoes(pane: UInt8Array) -> FloatArray:
    """Return the strength (n,) of a pane's own echo, as a reflectivity."""
    return np.asarray(_OPTICS["echo"][pane])


def mirrors(pane: UInt8Array, cosine: FloatArray) -> FloatArray:
    """Return the chance (n,) that what a pane does not return is mirrored, not transmitted."""
    mirrored = reflectance(pane, cosine) ** 2
    return np.asarray(mirrored / (mirrored + transmittance(pane, cosine) ** 2))


def leaves(pane: UInt8Array, cosine: FloatArray, mirrored: BoolArray) -> FloatArray:
    """Return the share (n,) of the signal left after a pane that mirrored it or not, both ways."""
    return np.where(mirrored, reflectance(pane, cosine), transmittance(pane, cosine)) ** 2


def _inside(cosine: FloatArray) -> FloatArray:
    """Return the cosine of refraction (n,)."""
    return np.asarray(np.sqrt(1.0 - (1.0 - np.asarray(cosine) ** 2) / _INDEX**2))
