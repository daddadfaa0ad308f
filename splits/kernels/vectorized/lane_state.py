"""State of all lanes, as a structure of arrays."""

from __future__ import annotations

from typing import NamedTuple

from numpy import int32, uint32

from splits.kernels.compiler.structure_of_arrays import StructureOfArrays
from splits.kernels.grains.free_path import FIRST_ROULETTE_DEPTH, LayerGeometry
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
    AT_BOUNDARY, AT_GROUND, RESTART, RELOCATE, LANE_ABSORBED, LANE_LOST, IDLE,
) = map(int32, range(11))  # fmt: skip
"""Status of a lane.  The flight pass serves `IN_FLIGHT`; the surface pass `AT_SURFACE` and the
cosine lobes on the near and on the far side.  The loop between the passes handles the rest: a
boundary, the ground, a restart of the flight in the layer of its start, a search for the layer,
finished rays (`LANE_ABSORBED`, `LANE_LOST`), and launches."""


class Material(NamedTuple):
    """Optical constants of a material: complex index, and absorption coefficient (1/m)."""

    refractive_index: ComplexIndex
    absorption: float


class Pore(NamedTuple):
    """Material of a pore, and its interfaces with cores for rays into and out of the grain."""

    material: Material
    inward: RelativeIndex
    outward: RelativeIndex


class Lane(StructureOfArrays, n_elements=N_LANES):
    """State of the ray in a lane; fields with a value have it when the ray is launched."""

    status: int32 = IN_FLIGHT
    ray: int  # Its row in the exits.
    item: int  # Its work item.
    key_high: uint32  # Key of its random stream, upper half.
    key_low: uint32  # Lower half.
    n_drawn: uint32 = uint32(1)  # Count of random numbers drawn.
    n_segments: int = 0  # Number of sampled grains.
    order: int = 0  # Order of scattering.
    max_order: int  # Order after which it counts as absorbed.

    # As in `base.ray.Ray`, with its previous segment.
    position: Vector = ORIGIN
    exit_offset: Vector = ORIGIN
    direction: Vector
    previous_direction: Vector = Vector(0.0, 0.0, -1.0)
    previous_length: float = -1.0
    start_distance: float = 0.0
    pore_variate: float
    weight: float = 1.0
    optical_depth: float = 0.0
    next_roulette: float = FIRST_ROULETTE_DEPTH

    # Path lengths (m) since the last flush.
    dry_path: float = 0.0
    wet_path: float = 0.0
    coating_path: float = 0.0
    core_path: float = 0.0

    # Layer of the ray.
    layer: int = 0  # Its number.
    layer_geometry: LayerGeometry
    wet_fraction: float  # Probability of wet pores.
    first_type: int  # First type of its grains.
    dry: Pore
    wet: Pore
    pore_wet: bool  # The pore of the ray is wet.

    # Flight through several layers.
    flight_layer: int = 0  # Layer of its start.
    draw_layer: int = 0  # Layer in which sampling starts, at `start_distance`.
    skip_distance: float = 0.0  # Distance of the last skipped grain (m).
    on_boundary: bool = False  # The flight starts on a boundary.
    segment_attenuated: bool = False  # The ray has been attenuated along its last segment.

    # Sampled grain.
    n_rejected: float = 0.0  # Number of successive rejections.
    keep_shape: bool = False  # The next sample has the same type and flattening.
    new_inverse_semi_major: float  # Curvature (1/m).
    new_flattening: float
    new_roughness: float
    new_type: int
    quantile_inverse_semi_major: float  # Position in the table of curvatures.
    quantile_flattening: float  # Position in that of flattenings, and then the value there.
    quantile_roughness: float  # Position in the table of roughnesses.
    u_type: float  # Random number of the type.
    chosen_type: int  # Type that it selects.

    # Grain at which the ray is.
    grain: Spheroid
    roughness: float  # Half of its facetness.
    shell: float  # Position among its shells, see `grains.interaction.InterfaceState`.
    side: float
    grain_type: int
    core_shell: float  # Shell number of the core.
    outer: Material  # Outermost shell.
    core: Material
    coating_thickness: float  # In m.


STATE_SIZE = N_LANES * Lane.n_rows
"""Numbers of the array of all lanes."""
