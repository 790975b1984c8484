"""Where one set of places in the plane lies over another, from wherever: each turn with every shift at once."""

import numpy as np
from scipy.ndimage import distance_transform_edt

from ffmap.algorithms.base.scan import FloatArray

_CELL_MIN_M, _CELLS_MAX, _TURN_STEP_DEG, _BLUR_CELLS = 0.2, 400, 2.0, 1.5


def likely_motions(source: FloatArray, target: FloatArray) -> list[FloatArray]:
    """Rank the rigid motions T_target_source (3, 3) of places (n, 2) onto others (m, 2), the best one of each turn.

    Every turn in steps of 2° is tried with every shift at once, by correlation with the blurred target (Chen and
    Defrise, 1994). Neither set may be empty.
    """
    from scipy.fft import irfft2, next_fast_len, rfft2  # a quarter of a second, which not every process needs

    centre = source.mean(axis=0)
    reach = float(np.linalg.norm(source - centre, axis=1).max())
    size = max(float(np.ptp(target, axis=0).max()), 2 * reach)
    cell_m = max(_CELL_MIN_M, size / _CELLS_MAX)
    low = target.min(axis=0) - 2 * cell_m
    shape = (np.ceil((np.ptp(target, axis=0) + 4 * cell_m) / cell_m)).astype(int) + 1
    hit = np.zeros(shape, bool)
    hit[tuple(np.floor((target - low) / cell_m).astype(int).T)] = True
    near = np.exp(-0.5 * (distance_transform_edt(~hit) / _BLUR_CELLS) ** 2)
    half = int(np.ceil(reach / cell_m)) + 1
    full = shape + 2 * half
    fast = [next_fast_len(int(length), real=True) for length in full]
    spectrum = rfft2(near, fast)
    found: list[tuple[float, FloatArray]] = []
    for turn in np.radians(np.arange(0.0, 360.0, _TURN_STEP_DEG)):
        R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        index = np.floor(((source - centre) @ R.T) / cell_m).astype(int) + half
        kernel = np.zeros((2 * half + 1, 2 * half + 1))
        np.add.at(kernel, tuple(index.T), 1.0)
        score = irfft2(spectrum * rfft2(np.minimum(kernel, 3.0)[::-1, ::-1], fast), fast)[: full[0], : full[1]]
        peak = np.unravel_index(int(np.argmax(score)), score.shape)
        # Index k of the full correlation lays the kernel's middle on cell k - half.
        middle = low + (np.array(peak) - half + 0.5) * cell_m
        T = np.eye(3)
        T[:2, :2], T[:2, 2] = R, middle - R @ centre
        found.append((float(score[peak]), T))
    found.sort(key=lambda candidate: -candidate[0])
    return [T for _, T in found]
