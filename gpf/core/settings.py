"""The base class of all settings, and the types of their values."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, PlainValidator
from pydantic_core import PydanticCustomError

Count = Annotated[int, Field(ge=1, lt=2**31)]
Seed = Annotated[int, Field(ge=0, lt=2**31)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Share = Annotated[float, Field(ge=0, lt=1)]


def _check_length(value: object) -> float | Literal["auto"]:
    """A positive number or ``auto``; pydantic's message for a union would list each type."""
    if value == "auto":
        return "auto"
    if isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < math.inf:
        return float(value)
    raise PydanticCustomError("length", "Input should be a number greater than 0, or auto")


Length = Annotated[float | Literal["auto"], PlainValidator(_check_length)]
"""A length in world units, above 0, or ``auto``."""


def _check_count(value: object) -> int | Literal["auto"]:
    if value == "auto":
        return "auto"
    if isinstance(value, int) and not isinstance(value, bool) and 0 < value < 2**31:
        return value
    raise PydanticCustomError(
        "count", "Input should be a whole number from 1 to 2147483647, or auto"
    )


AutoCount = Annotated[int | Literal["auto"], PlainValidator(_check_count)]
"""A whole number above 0, or ``auto``."""


class Settings(BaseModel):
    """Immutable settings, validated on creation; unknown keys are errors."""

    model_config = ConfigDict(frozen=True, extra="forbid")
