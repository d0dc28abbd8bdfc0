"""What a column and a table are: name, Arrow type, unit, meaning, nullability; the tables themselves are in schemas."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import pyarrow as pa

from tables.errors import PlaceBenchError
from tables.poses import pose_columns


class SchemaError(PlaceBenchError, ValueError):
    """A table that is not what its schema says; names table, column, value and bound."""


@dataclass(frozen=True, slots=True)
class Column:
    """One column; `values` closes the set of strings it may hold."""

    name: str
    dtype: pa.DataType
    meaning: str
    unit: str = ""
    nullable: bool = False
    values: tuple[str, ...] = ()

    def field(self) -> pa.Field:
        return pa.field(self.name, self.dtype, nullable=self.nullable)


@dataclass(frozen=True, slots=True)
class TableSchema:
    """Columns of a table and the key that sorts it and is unique in it.

    `since` is the schema version that last changed this table: files of that version and of all later ones hold it as it is now.
    """

    name: str
    meaning: str
    key: tuple[str, ...]
    columns: tuple[Column, ...]
    since: str = "2.0.0"

    def __post_init__(self) -> None:
        names = [column.name for column in self.columns]
        repeated = sorted({name for name in names if names.count(name) > 1})
        missing = [name for name in self.key if name not in names]
        if repeated or missing:
            raise SchemaError(f"{self.name}: repeated columns {repeated}, key columns missing {missing}")

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(column.name for column in self.columns)

    @property
    def arrow(self) -> pa.Schema:
        return pa.schema([column.field() for column in self.columns])

    @property
    def described(self) -> pa.Schema:
        """The same with what each column means as `description`, and its `unit` where it has one, in the metadata of its field."""
        fields = [(column, {"description": column.meaning, "unit": column.unit}) for column in self.columns]
        return pa.schema([column.field().with_metadata({k: v for k, v in words.items() if v}) for column, words in fields])


_CATEGORICAL = pa.dictionary(pa.int16(), pa.string())


def text(name: str, meaning: str, *, nullable: bool = False) -> Column:
    """A dictionary-encoded string column."""
    return Column(name, _CATEGORICAL, meaning, nullable=nullable)


def enum(name: str, values: type[StrEnum], meaning: str, *, nullable: bool = False) -> Column:
    """A dictionary-encoded string column with a closed set of values."""
    return Column(name, _CATEGORICAL, meaning, nullable=nullable, values=tuple(v.value for v in values))


def plain(name: str, meaning: str) -> Column:
    """A string column whose values hardly repeat, such as an id."""
    return Column(name, pa.string(), meaning)


def integer(name: str, meaning: str, *, unit: str = "", nullable: bool = False) -> Column:
    return Column(name, pa.int32(), meaning, unit, nullable)


def flag(name: str, meaning: str, *, nullable: bool = False) -> Column:
    return Column(name, pa.bool_(), meaning, nullable=nullable)


def real(name: str, meaning: str, unit: str = "", *, nullable: bool = False) -> Column:
    return Column(name, pa.float64(), meaning, unit, nullable)


def single(name: str, meaning: str, unit: str = "") -> Column:
    """A 32-bit float, for bulk data that no label is computed from.

    Measured label columns stay `real`: as singles they would save a tenth of a release without its heavy tables (2.4 of 24 MB at
    250,000 candidates), and the last bit is what shows that a repeat of physics is the same.
    """
    return Column(name, pa.float32(), meaning, unit)


def reals(name: str, meaning: str, unit: str = "", *, nullable: bool = False) -> Column:
    return Column(name, pa.list_(pa.float64()), meaning, unit, nullable)


def integers(name: str, meaning: str) -> Column:
    return Column(name, pa.list_(pa.int32()), meaning)


def pose(prefix: str, meaning: str, *, nullable: bool = False) -> tuple[Column, ...]:
    """Seven columns of a pose: metres and a unit quaternion xyzw."""
    units = ("m", "m", "m", "", "", "", "")
    return tuple(
        Column(name, pa.float64(), f"{meaning} ({name.rsplit('_', 2)[-2] if unit else name[-2:]})", unit, nullable)
        for name, unit in zip(pose_columns(prefix), units, strict=True)
    )


def joints(prefix: str, meaning: str, *, nullable: bool = False) -> tuple[Column, ...]:
    """Seven columns of an arm configuration: `<prefix>_1_rad` to `<prefix>_7_rad`."""
    return tuple(Column(name, pa.float64(), f"{meaning} (joint {k})", "rad", nullable) for k, name in enumerate(joint_columns(prefix), 1))


def joint_columns(prefix: str) -> tuple[str, ...]:
    """Column names of an arm configuration."""
    return tuple(f"{prefix}_{k}_rad" for k in range(1, 8))
