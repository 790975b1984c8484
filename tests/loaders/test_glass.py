"""Panes: Fresnel's reflectance, and what a beam does by the kind of glass and the angle."""

import numpy as np
import pytest

from ffmap.loaders.simulator.glass import OPTICS, Glass, echoes, leaves, mirrors, reflectance, returns, transmittance

COSINE = np.cos([0.0, 0.5, np.arctan(1.52), 1.3, 1.569])


def test_a_bare_sheet_reflects_as_fresnel_says() -> None:
    one_face = ((1.52 - 1) / (1.52 + 1)) ** 2
    found = reflectance(OPTICS[Glass.CLEAR], COSINE)
    assert found[0] == pytest.approx(2 * one_face / (1 + one_face))
    assert np.all(np.diff(found) > 0)
    assert found[-1] > 0.98
    # At Brewster's angle, arctan 1.52, light along the plane of incidence is not reflected: only the other half is.
    across = ((1 - 1.52**2) / (1 + 1.52**2)) ** 2
    assert found[2] == pytest.approx(0.5 * 2 * across / (1 + across), rel=1e-9)


@pytest.mark.parametrize("kind", OPTICS)
def test_no_light_is_made(kind: Glass) -> None:
    total = reflectance(OPTICS[kind], COSINE) + transmittance(OPTICS[kind], COSINE)
    assert np.all(total <= 1.0 + 1e-9)
    pane = np.full(len(COSINE), kind, np.uint8)
    for share in (returns(pane, COSINE), mirrors(pane, COSINE), echoes(pane, COSINE)):
        assert np.all((share >= 0) & (share <= 1))


def test_kinds_of_glass_differ() -> None:
    kinds = np.array([Glass.CLEAR, Glass.DOUBLE, Glass.COATED, Glass.MIRROR], np.uint8)
    steep = np.full(4, np.cos(np.radians(40.0)))
    assert np.all(np.diff(mirrors(kinds, steep)) > 0)
    assert np.all(np.diff(leaves(kinds, steep, np.ones(4, bool))) > 0)
    assert np.all(np.diff(leaves(kinds, steep, np.zeros(4, bool))) < 0)
    frosted = np.array([Glass.FROSTED, Glass.CLEAR], np.uint8)
    assert returns(frosted, steep[:2])[0] > 10 * returns(frosted, steep[:2])[1]
    assert returns(np.array([Glass.CLEAR], np.uint8), np.ones(1))[0] > 0.8  # the glint at right angles


def test_plain_panes_are_as_they_were() -> None:
    plain = np.zeros(3, np.uint8)
    cosine = np.array([1.0, 0.9925, 0.3])
    assert returns(plain, cosine) == pytest.approx([0.62, 0.32, 0.02])
    assert mirrors(plain, cosine) == pytest.approx(0.08 + 0.92 * (1 - cosine) ** 5)
    assert leaves(plain, cosine, np.array([True, False, False])) == pytest.approx([0.9, 0.8, 0.8])
