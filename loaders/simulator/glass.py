"""What a lidar's beam does at a pane: it comes back from it, is mirrored, or goes through.

A beam that is split returns the stronger echo. A ray cannot be split, so it is mirrored with the chance that the mirrored
echo is the stronger one were what lies on both sides alike: R² against T², for it passes the pane there and back.

Sources: Fresnel's equations for unpolarised light; refractive index 1.52 of soda-lime glass (EN 572-1 gives 1.50); a sheet of
6 mm clear float lets 0.8 to 0.9 of the near infrared through (EN 410, iron absorbs); solar-control coatings reflect 0.2 to
0.5 of it. Panes show in scans within a few degrees of the right angle (Foster, Sun, Park, Kuipers: VisAGGE, ICRA 2013).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import IntEnum
from types import MappingProxyType

import numpy as np

from ffmap.algorithms.base.scan import BoolArray, FloatArray, UInt8Array

_INDEX = 1.52


class Glass(IntEnum):
    """Kinds of panes. PLAIN: of the earlier buildings, an approximation that no angle but the right one distinguishes."""

    PLAIN = 0
    CLEAR = 1
    DOUBLE = 2
    COATED = 3
    FROSTED = 4
    MIRROR = 5


@dataclass(frozen=True)
class Optics:
    """sheets: of glass, one behind the other. through: share that one sheet does not absorb, at right angles. coating: share
    that is reflected beside what bare glass does. scattered: chance that dust or a rough surface returns the beam from any
    angle, with `echo` as its strength. glint_deg: off the right angle, where the mirrored beam still meets the sensor.
    """

    sheets: int
    through: float
    coating: float
    scattered: float
    echo: float
    glint_deg: float


OPTICS: Mapping[Glass, Optics] = MappingProxyType(
    {
        Glass.CLEAR: Optics(1, 0.88, 0.0, 0.01, 0.6, 2.0),
        Glass.DOUBLE: Optics(2, 0.88, 0.0, 0.02, 0.8, 2.0),
        Glass.COATED: Optics(2, 0.70, 0.35, 0.03, 1.0, 4.0),
        Glass.FROSTED: Optics(1, 0.80, 0.0, 0.75, 0.35, 4.0),
        Glass.MIRROR: Optics(1, 0.0, 0.88, 0.01, 1.0, 2.0),
    }
)


def reflectance(optics: Optics, cosine: FloatArray) -> FloatArray:
    """(n,) share of unpolarised light that is mirrored, by the cosine (n,) of incidence: Fresnel at every face, then coating."""
    inside = np.sqrt(1.0 - (1.0 - np.asarray(cosine) ** 2) / _INDEX**2)
    faces = 2 * optics.sheets

    def of_all_faces(one: FloatArray) -> FloatArray:
        """Light that goes back and forth between the faces adds up (Stokes)."""
        return np.asarray(faces * one / (1.0 + (faces - 1) * one))

    across = of_all_faces(((cosine - _INDEX * inside) / (cosine + _INDEX * inside)) ** 2)
    along = of_all_faces(((inside - _INDEX * cosine) / (inside + _INDEX * cosine)) ** 2)
    bare = 0.5 * (across + along)
    return np.asarray(bare + optics.coating * (1.0 - bare))


def transmittance(optics: Optics, cosine: FloatArray) -> FloatArray:
    """(n,) share that goes through, by the cosine (n,) of incidence: the way in the glass is longer aslant."""
    inside = np.sqrt(1.0 - (1.0 - np.asarray(cosine) ** 2) / _INDEX**2)
    return np.asarray((1.0 - reflectance(optics, cosine)) * optics.through ** (optics.sheets / inside))


def returns(pane: UInt8Array, cosine: FloatArray) -> FloatArray:
    """(n,) chance that a pane itself returns the beam. pane: (n,) codes of `Glass`."""

    def of(optics: Optics, cosine: FloatArray) -> FloatArray:
        glint = np.clip(2.0 - np.degrees(np.arccos(np.clip(cosine, 0.0, 1.0))) / optics.glint_deg, 0.0, 1.0)
        return np.maximum(optics.scattered, 0.9 * glint)

    # Plain: likely at right angles, otherwise rare (dust).
    return _by_kind(pane, cosine, np.asarray(0.02 + 0.6 * np.clip((cosine - 0.985) / 0.015, 0.0, 1.0)), of)


def echoes(pane: UInt8Array, cosine: FloatArray) -> FloatArray:
    """(n,) strength of what a pane itself returns, as a reflectivity."""
    return _by_kind(pane, cosine, np.ones(len(cosine)), lambda optics, cosine: np.full(len(cosine), optics.echo))


def mirrors(pane: UInt8Array, cosine: FloatArray) -> FloatArray:
    """(n,) chance that what a pane does not return is mirrored; else it goes through."""

    def of(optics: Optics, cosine: FloatArray) -> FloatArray:
        mirrored, through = reflectance(optics, cosine) ** 2, transmittance(optics, cosine) ** 2
        return np.asarray(mirrored / (mirrored + through))

    # Plain: Schlick's approximation for the pane's two faces.
    return _by_kind(pane, cosine, np.asarray(0.08 + 0.92 * (1.0 - cosine) ** 5), of)


def leaves(pane: UInt8Array, cosine: FloatArray, mirrored: BoolArray) -> FloatArray:
    """(n,) share of the signal that is left, there and back, after a pane that mirrored (n,) it or let it through."""

    def of(share: Callable[[Optics, FloatArray], FloatArray]) -> Callable[[Optics, FloatArray], FloatArray]:
        return lambda optics, cosine: np.asarray(share(optics, cosine) ** 2)

    after_mirror = _by_kind(pane, cosine, np.full(len(cosine), 0.9), of(reflectance))
    after_pane = _by_kind(pane, cosine, np.full(len(cosine), 0.8), of(transmittance))
    return np.where(mirrored, after_mirror, after_pane)


def _by_kind(
    pane: UInt8Array, cosine: FloatArray, plain: FloatArray, of: Callable[[Optics, FloatArray], FloatArray]
) -> FloatArray:
    values = plain.astype(np.float64)
    for kind in np.unique(pane[pane != Glass.PLAIN]):
        own = pane == kind
        values[own] = of(OPTICS[Glass(kind)], cosine[own])
    return values
