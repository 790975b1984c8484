"""Rows of a recording that are gathered and sent together: one by one, most of their cost is that of asking."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow as pa  # type: ignore[import-untyped]
import rerun as rr

from ffmap.blueprints import entities

Time = tuple[tuple[str, int], ...]
"""Where a row lies: on each of its timelines, nanoseconds on `stamp` and a number on others; nowhere, if it holds throughout."""
Values = Sequence[Any] | npt.NDArray[Any]
"""Of one component in a row: an array of numpy or Arrow with as many rows as it has instances, or a list."""


@dataclass(frozen=True)
class _Row:
    time: Time
    components: Mapping[str, Values]
    evidence: Mapping[str, npt.NDArray[Any]]


class Rows:
    """Rows by entity, all of one entity with the same components and on the same timelines."""

    def __init__(self) -> None:
        self._rows: dict[tuple[str, Any], list[_Row]] = {}

    def add(
        self,
        path: str,
        time: Time,
        archetype: Any,  # noqa: ANN401 - Rerun's archetypes have no common type
        components: Mapping[str, Values],
        evidence: Mapping[str, npt.NDArray[Any]],
    ) -> None:
        """archetype: what the components are of; None where there is evidence alone."""
        self._rows.setdefault((path, archetype), []).append(_Row(time, components, evidence))

    def drop(self, time: Time) -> None:
        """Keep no row of this time."""
        kept = {key: [row for row in rows if row.time != time] for key, rows in self._rows.items()}
        self._rows = {key: rows for key, rows in kept.items() if rows}

    def send(self, stream: rr.RecordingStream) -> None:
        """Log all rows into a stream, and keep none."""
        for (path, archetype), rows in self._rows.items():
            columns: list[Any] = []
            for name in rows[0].components:
                values = [row.components[name] for row in rows]
                columns += archetype.columns(**{name: _joined(values)}).partition([len(value) for value in values])
            for name in rows[0].evidence:
                arrays = [row.evidence[name] for row in rows]
                columns += rr.AnyValues.columns(**{name: typed(np.concatenate(arrays))}).partition(
                    [len(array) for array in arrays]
                )
            stream.send_columns(path, _times([row.time for row in rows]), columns)
        self._rows = {}


def _joined(values: Sequence[Values]) -> Values:
    if isinstance(values[0], np.ndarray):
        return np.concatenate(values)
    if isinstance(values[0], pa.Array):
        joined: Values = pa.concat_arrays(values)
        return joined
    return list(chain.from_iterable(values))


def _times(times: Sequence[Time]) -> list[rr.TimeColumn]:
    columns = []
    for at in zip(*times, strict=True):
        name, places = at[0][0], np.array([place for _, place in at])
        if name == entities.STAMP_TIMELINE:
            columns.append(rr.TimeColumn(name, timestamp=places.astype("datetime64[ns]")))
        else:
            columns.append(rr.TimeColumn(name, sequence=places))
    return columns


def typed(values: npt.NDArray[Any]) -> pa.Array:
    """An array as it is recorded, with the same type in every process even where it is empty."""
    kind: np.dtype[Any] = _KINDS.get(values.dtype.char, values.dtype)
    flat = pa.array(values.astype(kind, copy=False).ravel())
    return pa.FixedSizeListArray.from_arrays(flat, values.shape[1]) if values.ndim == 2 else flat


_KINDS: dict[str, np.dtype[Any]] = {"d": np.dtype(np.float32), "l": np.dtype(np.int32), "?": np.dtype(np.uint8)}
"""As what arrays of 64-bit numbers and of truth values are recorded, by the characters that numpy has for these."""
