"""Columns: type in Arrow and in SQL, unit, meaning, allowed values; and short functions to declare one."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

import pyarrow as pa

GEO_CRS = "EPSG:4979"


class Kind(StrEnum):
    """A column's type; geometry is WKB whose CRS is ``GEO_CRS`` (lon, lat, ellipsoidal height)."""

    TEXT = "text"
    INTEGER = "integer"
    REAL = "real"
    BOOLEAN = "boolean"
    TIME = "time"
    GEOMETRY = "geometry"
    REALS = "reals"

    @property
    def arrow(self) -> pa.DataType:
        """The Arrow type."""
        return {
            Kind.TEXT: pa.string(),
            Kind.INTEGER: pa.int64(),
            Kind.REAL: pa.float64(),
            Kind.BOOLEAN: pa.bool_(),
            Kind.TIME: pa.timestamp("us", tz="UTC"),
            Kind.GEOMETRY: pa.binary(),
            Kind.REALS: pa.list_(pa.float64()),
        }[self]

    @property
    def sql(self) -> str:
        """The type in the lake."""
        return {
            Kind.TEXT: "VARCHAR",
            Kind.INTEGER: "BIGINT",
            Kind.REAL: "DOUBLE",
            Kind.BOOLEAN: "BOOLEAN",
            Kind.TIME: "TIMESTAMP WITH TIME ZONE",
            Kind.GEOMETRY: "GEOMETRY",  # DuckLake 1.0 drops a CRS from the type; the column's comment has it
            Kind.REALS: "DOUBLE[]",
        }[self]


@dataclass(frozen=True, kw_only=True)
class Column:
    """One column; ``minimum`` and ``maximum`` are inclusive."""

    name: str
    kind: Kind
    meaning: str
    unit: str = ""
    allowed: tuple[str, ...] = ()
    minimum: float | None = None
    maximum: float | None = None


def text(name: str, meaning: str, allowed: Iterable[str] = ()) -> Column:
    """A column of text."""
    return Column(name=name, kind=Kind.TEXT, meaning=meaning, allowed=tuple(str(word) for word in allowed))


def real(name: str, unit: str, meaning: str, low: float | None = None, high: float | None = None) -> Column:
    """A column of real numbers in ``unit``."""
    return Column(name=name, kind=Kind.REAL, unit=unit, meaning=meaning, minimum=low, maximum=high)


def count(name: str, meaning: str, low: float = 0) -> Column:
    """A column of counts."""
    return Column(name=name, kind=Kind.INTEGER, meaning=meaning, minimum=low)


def time(name: str, meaning: str) -> Column:
    """A column of times, UTC."""
    return Column(name=name, kind=Kind.TIME, meaning=meaning, unit="UTC")


def flag(name: str, meaning: str) -> Column:
    """A boolean column."""
    return Column(name=name, kind=Kind.BOOLEAN, meaning=meaning)
