"""Numbers, option values and dates as a page shows them."""

import datetime
import json
import math
from typing import Any

import numpy as np


def number_text(value: float | None, digits: int) -> str:
    """Return a number with `digits` after the point, `–` for None and nan."""
    return "–" if value is None or math.isnan(value) else f"{value:,.{digits}f}".replace("-", "−")


def steps_text(steps: int | None) -> str:
    """Return a number of steps in short, such as 500, 20k or 2.5M; `–` for None."""
    if steps is None:
        return "–"
    for unit, name in ((1_000_000, "M"), (1_000, "k")):
        if steps >= unit:
            return f"{steps / unit:.3g}{name}"
    return str(steps)


def option_text(value: Any) -> str:
    """Return the value of an option as JSON, a string without its quotes."""
    if isinstance(value, str):
        return value
    return json.dumps(np.asarray(value).tolist() if hasattr(value, "shape") else value, default=str)


def date_text(moment: datetime.datetime) -> str:
    """Return a date such as 3 May 2026."""
    return f"{moment.day} {moment:%B %Y}"
