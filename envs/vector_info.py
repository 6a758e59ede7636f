"""Infos of many rows in the form of gymnasium: for every key an array over rows, and `_key`, which rows have it."""

from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]


def picked(info: dict[str, Any], rows: Array) -> dict[str, Any]:
    """Return an info that only some rows have, given as a mask, bool (n,); others show 0 or None. Nested dicts are infos too."""
    if not rows.any():
        return {}
    return _picked(info, rows.copy(), np.flatnonzero(~rows))


def _picked(info: dict[str, Any], rows: Array, others: Array) -> dict[str, Any]:
    """Return the same, given the rows that do not have it too."""
    found: dict[str, Any] = {}
    for key, values in info.items():
        if isinstance(values, dict):
            found[key] = _picked(values, rows, others)
        elif not len(others):
            found[key] = values
        else:
            found[key] = values.copy()
            found[key][others] = None if values.dtype == object else 0
        found[f"_{key}"] = rows
    return found


def joined(one: dict[str, Any], other: dict[str, Any]) -> dict[str, Any]:
    """Return two infos as one, which no row has both of."""
    found = one | {key: values for key, values in other.items() if key not in one}
    for key in one.keys() & other.keys():
        if key.startswith("_"):
            found[key] = one[key] | other[key]
        elif isinstance(one[key], dict):
            found[key] = joined(one[key], other[key])
        else:
            found[key] = np.where(other[f"_{key}"], other[key], one[key])
    return found
