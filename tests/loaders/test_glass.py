"""Panes: Fresnel's reflectance, and what a beam does by the kind of glass and the angle."""

import numpy as np
import pytest

from ffmap.algorithms.base.scan import UInt8Array
from ffmap.loaders.simulator.glass import (
    Glass,
    echoes,
    leaves,
    mirrors,
    reflectance,
    returns,
    transmittance,
)

COSINE = np.cos([0.0, 0.5, np.arctan(1.52), 1.3, 1.569])


def panes(*kinds: Glass) -> UInt8Array:
    return np.array(kinds, np.uint8)


def test_a_bare_sheet_reflects_by_fresnels_equations() -> None:
    one_face = ((1.52 - 1) / (1.52 + 1)) ** 2
    found = reflectance(panes(Glass.CLEAR), COSINE)
    assert found[0] == pytest.approx(2 * one_face / (1 + one_face))
    assert np.all(np.diff(found) > 0)
    assert found[-1] > 0.98
    # At Brewster's angle, arctan 1.52, only light across the plane of incidence is reflected.
    across = ((1 - 1.52**2) / (1 + 1.52**2)) ** 2
    assert found[2] == pytest.approx(0.5 * 2 * across / (1 + across), rel=1e-9)


@pytest.mark.parametrize("kind", Glass)
def test_no_light_is_made(kind: Glass) -> None:
    pane = panes(kind)
    total = reflectance(pane, COSINE) + transmittance(pane, COSINE)
    assert np.all(total <= 1.0 + 1e-9)
    for share in (returns(pane, COSINE), mirrors(pane, COSINE), echoes(pane)):
        assert np.all((share >= 0) & (share <= 1))


def test_kinds_of_glass_differ() -> None:
    kinds = panes(Glass.CLEAR, Glass.DOUBLE, Glass.COATED, Glass.MIRROR)
    steep = np.full(4, np.cos(np.radians(40.0)))
    assert np.all(np.diff(mirrors(kinds, steep)) > 0)
    assert np.all(np.diff(leaves(kinds, steep, np.ones(4, bool))) > 0)
    assert np.all(np.diff(leaves(kinds, steep, np.zeros(4, bool))) < 0)
    frosted = panes(Glass.FROSTED, Glass.CLEAR)
    assert returns(frosted, steep[:2])[0] > 10 * returns(frosted, steep[:2])[1]
    assert returns(frosted[1:], np.ones(1))[0] > 0.8  # The glint at normal incidence
