"""A class of options in a module whose annotations are text until someone evaluates them."""

from __future__ import annotations

import dataclasses
from typing import Literal


@dataclasses.dataclass
class Postponed:
    limit: float | None = None
    most: int | None = 5
    mode: Literal["a", "b"] = "a"
