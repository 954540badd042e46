"""Types of numbers and names that the parts of a scene are made of."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Finite = Annotated[float, Field(allow_inf_nan=False)]
NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Unit = Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)]
Vec3 = tuple[Finite, Finite, Finite]
Rgb = tuple[NonNegative, NonNegative, NonNegative]
Row = tuple[Finite, Finite, Finite, Finite]
Matrix4 = tuple[Row, Row, Row, Row]
Affine2 = tuple[tuple[Finite, Finite, Finite], tuple[Finite, Finite, Finite]]
Name = Annotated[str, Field(min_length=1, max_length=256)]


class Node(BaseModel):
    """Base of all parts of a scene: unknown fields are errors."""

    model_config = ConfigDict(extra="forbid", arbitrary_types_allowed=True)
