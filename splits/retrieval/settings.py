"""Settings of a retrieval as attributes of its result: model, free and fixed parameters, priors."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from splits.core.arrays import check_named_numbers
from splits.retrieval.state_vector import StateVector
from splits.tables.table import Table

FIXED_PREFIX = "fixed_"
"""Beginning of the attributes of fixed values."""
TABLE_SOLVER = "table"
"""Attribute ``solver`` of a retrieval with a table."""


def describe_model(model: Any, solver: str) -> dict[str, Any]:
    """Return the attributes of a model: its solver and its medium.

    Parameters
    ----------
    model : Table or Medium
        Values of free parameters in a medium have no effect.
    solver : str
    """
    if isinstance(model, Table):
        medium = model.dataset.attrs.get("medium")
        return {"solver": solver} | ({} if medium is None else {"medium": medium})
    details = {f"{model.kind}_{key}": value for key, value in model.describe().items()}
    return {"solver": solver, "medium": model.kind, **details}


def describe_parameters(
    state_vector: StateVector, fixed: Mapping[str, Any], prior: Mapping[str, Any] | None, seed: int
) -> dict[str, Any]:
    """Return the attributes of the free and fixed parameters and of the seed.

    ``free_NAME`` is the range (low, high), ``prior_NAME`` the prior (mean, standard deviation) as
    given, and ``fixed_NAME`` a fixed value.
    """
    limits = zip(state_vector.names, state_vector.low, state_vector.high, strict=True)
    names = ("mean", "standard deviation")
    return {
        **{f"{FIXED_PREFIX}{name}": value for name, value in fixed.items()},
        **{f"free_{name}": [float(low), float(high)] for name, low, high in limits},
        **{
            f"prior_{name}": list(check_named_numbers(f"prior.{name}", pair, names))
            for name, pair in (prior or {}).items()
        },
        "seed": seed,
    }
