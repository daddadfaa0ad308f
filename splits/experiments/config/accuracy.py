"""Accuracy level of a run."""

from __future__ import annotations

from pydantic import Field

from splits.experiments.config.sections import ConfigSection


class Accuracy(ConfigSection):
    """Target standard errors and the limit of rays of simulations."""

    max_stderr: float = Field(ge=1e-6, le=0.5)
    """largest standard error of a hemispherical quantity"""
    relative_stderr: float = Field(0.02, ge=1e-4, le=0.5)
    """largest relative standard error of a value by direction or position"""
    max_rays: int | None = Field(None, ge=1, lt=2**63)
    """largest number of rays per spectrum, or per set of spectra that share paths, even if the
    target error is not reached; by default that of the instrument"""
