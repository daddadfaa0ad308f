"""Random number streams: instruments and strata use independent streams for one seed."""

from __future__ import annotations

import importlib
import pkgutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np

import splits
from splits.instruments.angular_tallies import ORDER_CLASSES, AngularBinTally, ExpansionTally
from splits.instruments.beam_spread import BeamSpreadTally
from splits.instruments.flux_tally import FluxTally
from splits.kernels.tallies.distributions import make_basis
from splits.simulation.grain_optics import SingleScatteringTally
from splits.simulation.scene import OpticalConstants, build_scene
from splits.simulation.shared_paths import SpectralRows
from splits.simulation.spectral_nodes import MAX_SEPARATE_NODES, make_separate_nodes
from splits.simulation.spectral_tally import ANALOG_STREAM, SpectralTally
from splits.simulation.strata import STRATUM_BOUNDS
from splits.simulation.tally import Tally


def list_tally_classes(base=Tally):
    """Return the classes of tallies of the package that have random streams."""
    classes = set()
    for child in base.__subclasses__():
        if child.__module__.startswith("splits."):
            classes |= list_tally_classes(child) | (
                {child} if "first_stream" in vars(child) else set()
            )
    return classes


def test_first_streams_leave_room_for_all_strata():
    for module in pkgutil.walk_packages(splits.__path__, "splits."):
        importlib.import_module(module.name)
    offsets = sorted([ANALOG_STREAM, *(one.first_stream for one in list_tally_classes())])
    max_streams = MAX_SEPARATE_NODES * max(len(STRATUM_BOUNDS), len(ORDER_CLASSES))
    assert len(set(offsets)) == len(offsets) == 10
    assert min(np.diff(offsets)) > max_streams


def test_strata_have_different_streams():
    """Three nodes, each used at three wavelengths of increasing absorption."""
    index = np.array([[1.3, 1.3], [1.4, 1.4], [1.5, 1.5]]) + 0j
    absorption = np.repeat([[0.0], [9.0], [99.0]], 2, axis=1)
    nodes = replace(make_separate_nodes(index), weights=np.full((3, 3), 1.0 / 3.0))
    scene = build_scene(splits.Snow(depth_m=1.0), 0.0, analog=False)
    analog_scene = scene._replace(rules=scene.rules._replace(analog=True))
    rows = SpectralRows(index, absorption, absorption, np.zeros((0, 3, 2)), ())
    traced_medium = SimpleNamespace(
        constants=OpticalConstants(index, absorption), path_fractions=None, planes_m=np.ones(2),
    )  # fmt: skip
    directions = SimpleNamespace(basis=make_basis(2))
    tallies = {
        SpectralTally(rows, nodes, scene): 9,
        SpectralTally(rows, nodes, analog_scene): 3,
        FluxTally(nodes, traced_medium, scene, None): 9,
        ExpansionTally(nodes, absorption, directions, 30.0, None): 3 * len(ORDER_CLASSES),
        AngularBinTally(nodes, absorption, (2, 2), False): 3,
        BeamSpreadTally(nodes, absorption, 1.0): 3,
        BeamSpreadTally(nodes, absorption, 1.0, first_node=3): 3,
        SingleScatteringTally(nodes, absorption, np.zeros(3), 2, 2048): 3,
    }
    for tally, n_strata in tallies.items():
        assert len(tally.strata) == n_strata
    streams = [stratum.stream for tally in tallies for stratum in tally.strata]
    assert len(set(streams)) == len(streams)
