"""Dataclasses of arrays and numbers as named arrays, as files hold them, and back."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any, TypeVar, get_origin

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

    _T = TypeVar("_T", bound=DataclassInstance)

Arrays = Mapping[str, npt.NDArray[Any]]


def pack(answer: "DataclassInstance", prefix: str = "") -> Arrays:
    """Every field by its name."""
    return {prefix + field.name: np.asarray(getattr(answer, field.name)) for field in fields(answer)}


def unpack(kind: "type[_T]", arrays: Arrays, prefix: str = "") -> "_T":
    """What `pack` made arrays of."""
    return kind(**{field.name: _value(field.type, arrays[prefix + field.name]) for field in fields(kind)})


def pack_ragged(name: str, parts: Sequence[npt.NDArray[Any]]) -> Arrays:
    """Arrays of any lengths as one, and their lengths."""
    return {
        name: np.concatenate(parts) if parts else np.zeros(0),
        f"{name}_length": np.array([len(part) for part in parts], np.int64),
    }


def unpack_ragged(name: str, arrays: Arrays) -> list[npt.NDArray[Any]]:
    """What `pack_ragged` made one of."""
    whole, lengths = arrays[name], arrays[f"{name}_length"]
    return [whole[end - length : end] for length, end in zip(lengths, np.cumsum(lengths), strict=True)]


def pack_rows(rows: "Sequence[DataclassInstance]", ragged: Sequence[str]) -> Arrays:
    """Every field of some dataclasses of one kind, row by row. ragged: fields whose arrays have any lengths."""
    columns = {field.name: [getattr(row, field.name) for row in rows] for field in fields(rows[0])}
    packed = {name: np.array(values) for name, values in columns.items() if name not in ragged}
    for name in ragged:
        packed |= pack_ragged(name, columns[name])
    return packed


def unpack_rows(kind: "type[_T]", arrays: Arrays, ragged: Sequence[str]) -> "list[_T]":
    """What `pack_rows` made arrays of."""
    columns = {
        field.name: unpack_ragged(field.name, arrays)
        if field.name in ragged
        else [_value(field.type, value) for value in arrays[field.name]]
        for field in fields(kind)
    }
    return [kind(**dict(zip(columns, row, strict=True))) for row in zip(*columns.values(), strict=True)]


def _value(kind: Any, stored: Any) -> Any:  # noqa: ANN401 - a field's type, and a value of it
    if kind in (int, float, bool):
        return kind(stored)
    return tuple(stored.tolist()) if get_origin(kind) is tuple else stored
