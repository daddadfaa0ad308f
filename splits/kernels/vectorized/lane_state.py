"""State of all lanes, as a structure of arrays, and constants of the passes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy import int32, uint32

from splits.kernels.compiler.structure_of_arrays import StructureOfArrays
from splits.kernels.grains.free_path import FIRST_ROULETTE_DEPTH, LayerGeometry, RejectionRules
from splits.kernels.grains.interaction import RelativeIndex
from splits.kernels.grains.spheroid import Spheroid
from splits.kernels.math.vectors import ORIGIN, Vector
from splits.kernels.optics.interface import ComplexIndex

N_LANES = 64
"""Number of lanes: enough to fill vectors and to keep both passes busy, few enough for the
cache."""

VECTOR_WIDTH = 16
"""Lanes of the widest vectors of current processors."""

STRIDE = 2 * VECTOR_WIDTH
"""Lanes per inner loop of a pass."""

(
    IN_FLIGHT, AT_SURFACE, IN_REFLECTED_LOBE, IN_TRANSMITTED_LOBE,
    AT_BOUNDARY, AT_GROUND, RESTART, RELOCATE, ABSORBED, LOST, IDLE,
) = map(int32, range(11))  # fmt: skip
"""Status of a lane.  The flight pass serves `IN_FLIGHT`; the surface pass `AT_SURFACE` and the
cosine lobes on the near and on the far side.  The loop between the passes handles the rest: a
boundary, the ground, a restart of the flight in the layer of its start, a search for the layer,
finished rays (`ABSORBED`, `LOST`), and launches."""


class Medium(NamedTuple):
    """Optical constants of a material: complex index, and absorption coefficient (1/m)."""

    refractive_index: ComplexIndex
    absorption: float


class Lane(StructureOfArrays, n_elements=N_LANES):
    """State of the ray in a lane; fields with a value have it when the ray is launched."""

    status: int32 = IN_FLIGHT
    ray: int  # Its row in the exits.
    item: int  # Its work item.

    # Random stream: halves of its key, and count of numbers drawn.
    key_high: uint32
    key_low: uint32
    n_drawn: uint32 = uint32(1)

    n_segments: int = 0  # Sampled grains.
    order: int = 0  # Order of scattering.
    max_order: int  # Order after which the ray counts as absorbed.

    # Position and roulette, as in `grains.ray.Ray`.
    position: Vector = ORIGIN
    exit_offset: Vector = ORIGIN
    direction: Vector
    previous_direction: Vector = Vector(0.0, 0.0, -1.0)
    previous_length: float = -1.0
    start_distance: float = 0.0
    weight: float = 1.0
    optical_depth: float = 0.0
    next_roulette: float = FIRST_ROULETTE_DEPTH

    # Path lengths since the last flush (m).
    dry_path: float = 0.0
    wet_path: float = 0.0
    coating_path: float = 0.0
    core_path: float = 0.0

    # Pore and layer.
    pore_wet: bool
    pore_variate: float  # Random number that selects the pore.
    layer: int = 0
    layer_geometry: LayerGeometry
    wet_fraction: float
    first_type: int
    dry: Medium
    wet: Medium

    # Flight through several layers.
    flight_layer: int = 0  # Layer of its start.
    draw_layer: int = 0  # Layer of the start of sampling.
    skip_distance: float = 0.0  # Distance of the last skipped grain (m).
    on_boundary: bool = False  # It starts on a boundary.
    segment_attenuated: bool = False  # The last segment has been attenuated.

    # Sampled grain, and positions in the tables; `quantile_flattening` is replaced by its value.
    n_rejected: float = 0.0  # Successive rejections.
    keep_shape: bool = False  # Type and shape are not sampled again.
    new_inverse_semi_major: float
    new_flattening: float
    new_roughness: float
    new_type: int
    quantile_inverse_semi_major: float
    quantile_flattening: float
    quantile_roughness: float
    u_type: float
    chosen_type: int

    # Grain of the ray.
    grain: Spheroid
    roughness: float  # Half facetness.
    shell: float  # Shell of the ray, see `grains.interaction.InterfaceState`.
    side: float
    grain_type: int
    core_shell: float  # Shell number of the core.
    outer: Medium  # Outermost shell.
    core: Medium
    coating_thickness: float  # In m.

    # Interfaces of grains of a single type, for rays that travel inwards and outwards.
    inward_dry: RelativeIndex
    inward_wet: RelativeIndex
    outward_dry: RelativeIndex
    outward_wet: RelativeIndex


STATE_SIZE = N_LANES * Lane.n_rows


class PassConstants(NamedTuple):
    """Constants of a scene that the passes use, float32 (m) except for the rules.

    Attributes
    ----------
    layer_geometry : LayerGeometry
    rejection_rules : RejectionRules
    wet_fraction : float32
    facet_sampling : int32
    mirror_wrong_side, point_grains : bool
    """

    layer_geometry: LayerGeometry
    rejection_rules: RejectionRules
    wet_fraction: np.float32
    facet_sampling: np.int32
    mirror_wrong_side: np.bool_
    point_grains: np.bool_
