"""Lanes: state, random numbers, motion and optics of many rays, and hints to the compiler."""

from __future__ import annotations

import re
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.extending import intrinsic
from numpy import float32 as single
from numpy import int32, uint32

from splits.kernels.arithmetic import select, to_single
from splits.kernels.compiler.jit import HALF, ONE, ZERO, inline_allocating, inline_only
from splits.kernels.compiler.structure_of_arrays import StructureOfArrays, list_addresses
from splits.kernels.grains.grain_path import get_layer_geometry, refractive_index_of
from splits.kernels.grains.spheroid import FIRST_ROULETTE_DEPTH, LayerGeometry, Spheroid
from splits.kernels.grains.surface import RelativeIndex
from splits.kernels.interface import ComplexIndex
from splits.kernels.rng import GOLDEN_GAMMA, mix64
from splits.kernels.scene import ORIGIN, WET_PORE, Ray, Segment, Vector

# --------------------------------------------------------------------------------------------------
# State of all lanes, as a structure of arrays.

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

    # As in `scene.Ray`, with its previous segment.
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
    shell: float  # Position among its shells, see `surface.InterfaceState`.
    side: float
    grain_type: int
    core_shell: float  # Shell number of the core.
    outer: Material  # Outermost shell.
    core: Material
    coating_thickness: float  # In m.


STATE_SIZE = N_LANES * Lane.n_rows
"""Numbers of the array of all lanes."""


# --------------------------------------------------------------------------------------------------
# LLVM intrinsics and hints: vector width, loop interleaving, and gathers.

_INT, _LONG = ir.IntType(32), ir.IntType(64)
_INTS, _LONGS, _FLOATS = (
    ir.VectorType(kind, VECTOR_WIDTH) for kind in (_INT, _LONG, ir.FloatType())
)


@intrinsic
def prefer_512_bit_vectors(typing_context):
    """Mark the function that calls this with LLVM's attribute prefer-vector-width=512.

    By default LLVM uses 256 bits on processors with 512, because early ones reduced their clock
    rate; for these passes 512 bits are about twice as fast.  Other machines ignore the attribute.
    """

    def generate(context, builder, signature, arguments):
        # llvmlite accepts attributes without a value only; its base class, a set, accepts any text.
        set.add(builder.function.attributes, '"prefer-vector-width"="512"')
        return context.get_dummy_value()

    return types.void(), generate


@intrinsic
def interleave_loops(typing_context):
    """Mark the loops above, in the function that calls this, with llvm.loop.interleave.count=2.

    An interaction is one long chain of dependent operations; two interleaved vectors hide their
    latency.  LLVM, which considers registers only, would not interleave.
    """

    def generate(context, builder, signature, arguments):
        module = builder.module
        name = ir.MetaDataString(module, "llvm.loop.interleave.count")
        count = module.add_metadata([name, ir.Constant(ir.IntType(32), 2)])
        for block in builder.function.blocks:
            end = block.terminator
            if isinstance(end, ir.Branch) and _get_bytecode_offset(
                end.operands[0]
            ) < _get_bytecode_offset(block):
                loop = module.add_metadata([count])
                # LLVM identifies a loop by metadata that refers to itself.
                loop.operands = (loop, count)
                end.set_metadata("llvm.loop", loop)
        return context.get_dummy_value()

    return types.void(), generate


def _get_bytecode_offset(block: ir.Block) -> int:
    """Return the bytecode offset of a block from its name, such as B216 or B74.endif."""
    found = re.match(r"B(\d+)", block.name)
    return int(found[1]) if found else 0


@intrinsic(prefer_literal=True)
def gather_interpolate(typing_context, table, lane, row, position, value):
    """Interpolate a table linearly for `VECTOR_WIDTH` lanes at once.

    LLVM cannot prove that stores to lanes do not change the table, and loads its values one by one;
    an explicit gather takes a fifth of the time.

    Parameters
    ----------
    table : float32[rows, points]
    lane : Lane
        The first one.
    row, position, value : str
        Fields of the row in the table (clipped to the last one), of the position from 0 to
        points − 1, and of the interpolated value.
    """

    def generate(context, builder, signature, arguments):
        values = context.make_array(table)(context, builder, arguments[0])
        rows, points = (builder.trunc(n, _INT) for n in cgutils.unpack_tuple(builder, values.shape))

        def locate(field, kind):
            address = next(list_addresses(builder, lane, arguments[1], field.literal_value))
            return builder.bitcast(address, kind.as_pointer())

        def clip(number, limit):
            limit = _broadcast(builder, limit, _INTS)
            return builder.select(builder.icmp_signed("<", number, limit), number, limit)

        at = builder.load(locate(position, _FLOATS), align=4)
        below = clip(builder.fptosi(at, _INTS), builder.sub(points, _INT(2)))
        fraction = builder.fsub(at, builder.sitofp(below, _FLOATS))
        which = clip(builder.load(locate(row, _INTS), align=4), builder.sub(rows, _INT(1)))
        offset = builder.add(builder.mul(which, _broadcast(builder, points, _INTS)), below)
        start, step = builder.ptrtoint(values.data, _LONG), _LONGS([4] * VECTOR_WIDTH)
        offset = builder.mul(builder.zext(offset, _LONGS), step)
        low_at = builder.add(_broadcast(builder, start, _LONGS), offset)
        low, high = _gather(builder, low_at), _gather(builder, builder.add(low_at, step))
        result = builder.fadd(low, builder.fmul(fraction, builder.fsub(high, low)))
        builder.store(result, locate(value, _FLOATS), align=4)
        return context.get_dummy_value()

    return types.void(table, lane, row, position, value), generate


def _broadcast(builder: Any, value: Any, kind: ir.VectorType) -> Any:
    """Return a vector of equal numbers."""
    first = builder.insert_element(kind(ir.Undefined), value, _INT(0))
    return builder.shuffle_vector(first, kind(ir.Undefined), _INTS([0] * VECTOR_WIDTH))


def _gather(builder: Any, addresses: Any) -> Any:
    """Load a number from each address of a vector."""
    mask = ir.VectorType(ir.IntType(1), VECTOR_WIDTH)
    pointers = ir.VectorType(ir.FloatType().as_pointer(), VECTOR_WIDTH)
    gather = cgutils.get_or_insert_function(
        builder.module,
        ir.FunctionType(_FLOATS, [pointers, _INT, mask, _FLOATS]),
        f"llvm.masked.gather.v{VECTOR_WIDTH}f32.v{VECTOR_WIDTH}p0",
    )
    addresses, everywhere = builder.inttoptr(addresses, pointers), mask([1] * VECTOR_WIDTH)
    return builder.call(gather, [addresses, _INT(4), everywhere, _FLOATS(ir.Undefined)])


# --------------------------------------------------------------------------------------------------
# Random numbers of the lanes: the streams of `splits.kernels.rng` in single precision.

_MASK_21 = np.uint64(0x1FFFFF)
_MASK_23 = np.uint64(0x7FFFFF)
_MASK_31 = np.uint64(0x7FFFFFFF)
_SCALE_21 = single(2.0**-21)
_SCALE_23 = single(2.0**-23)
_SCALE_31 = single(2.0**-31)
_SCALE_46 = single(2.0**-46)
_LARGEST_BELOW_ONE = single(1.0 - 2.0**-24)


@inline_only
def compute_random_bits(lane, offset):
    """Return 64 random bits of the stream of a lane, `offset` numbers ahead of its counter."""
    key = (np.uint64(lane.key_high) << np.uint64(32)) | np.uint64(lane.key_low)
    number = np.uint32(lane.n_drawn + np.uint32(offset))
    return mix64(key + np.uint64(number) * GOLDEN_GAMMA)


@inline_only
def draw_uniform(lane):
    """Draw the next random number of a lane in double precision."""
    u = to_uniform_52(compute_random_bits(lane, 0))
    lane.n_drawn += np.uint32(1)
    return u


@inline_only
def to_three_uniforms(bits):
    """Return three numbers uniform on (0, 1) of 21 bits each, at the centres of their intervals."""
    return (
        (single(np.int32(bits & _MASK_21)) + HALF) * _SCALE_21,
        (single(np.int32((bits >> np.uint64(21)) & _MASK_21)) + HALF) * _SCALE_21,
        (single(np.int32(bits >> np.uint64(43))) + HALF) * _SCALE_21,
    )


@inline_only
def to_uniform_46(bits):
    """Return a number uniform on (0, 1] with 46 bits near 0, for logarithms.

    It limits free paths to 32 mean free paths; 24 bits would limit them to 17.
    """
    high = single(np.int32(bits >> np.uint64(41)))
    low = single(np.int32((bits >> np.uint64(18)) & _MASK_23))
    return high * _SCALE_23 + (low + HALF) * _SCALE_46


@inline_only
def to_uniform_31(bits):
    """Return a number uniform on (0, 1) from the lowest 31 bits.

    Values that single precision would round to 1 are reduced, because cumulative distributions need
    u < 1.
    """
    u = (single(np.int32(bits & _MASK_31)) + HALF) * _SCALE_31
    return u if u < ONE else _LARGEST_BELOW_ONE


@inline_only
def to_uniform_52(bits):
    """Return a number uniform on (0, 1) of 52 bits, as `rng.uniform` does."""
    return (float(bits >> np.uint64(12)) + 0.5) * 2.0**-52


# --------------------------------------------------------------------------------------------------
# Geometry and motion of the rays of lanes between grains.


@inline_only
def load_ray(lane):
    """Return the `Ray` of a lane, with None for the fields that a flight does not need."""
    previous_segment = Segment(
        lane.previous_direction, lane.previous_direction, lane.previous_length
    )
    return Ray(
        None, lane.position, lane.exit_offset, lane.direction, previous_segment,
        lane.start_distance, None, None, lane.weight, lane.optical_depth, lane.next_roulette,
        None, None, None, None,
    )  # fmt: skip


@inline_only
def has_left_layer(lane, ray, layer_geometry):
    """Return whether a ray left a grain on the other side of a boundary between layers."""
    z = ray.position.z + ray.exit_offset.z
    above = (z > layer_geometry.top) & (layer_geometry.top < layer_geometry.slab_top)
    below = (z < layer_geometry.bottom) & (layer_geometry.bottom > layer_geometry.slab_bottom)
    return (lane.layer == lane.flight_layer) & (not lane.on_boundary) & (above | below)


@inline_only
def move_to_grain(lane, ray, collision, accepted, features):
    """Move the ray of a lane to the accepted grain, if there is one."""
    position, exit_offset, d, distance = (
        ray.position, ray.exit_offset, ray.direction, collision.distance
    )  # fmt: skip
    entry_point = Vector(
        position.x + exit_offset.x + distance * d.x,
        position.y + exit_offset.y + distance * d.y,
        collision.height,
    )
    lane.position = select(accepted, entry_point, position)
    lane.exit_offset = select(accepted, Vector(ZERO, ZERO, ZERO), exit_offset)
    lane.previous_direction = select(accepted, d, ray.previous_segment.direction)
    lane.previous_length = select(accepted, distance, ray.previous_segment.length)
    # In layered scenes the segment is attenuated between the passes.
    if features.layered is None:
        attenuate(lane, select(accepted, distance, ZERO), features)


@inline_only
def move_to_boundary(lane, ray, boundary_hit):
    """Move the ray of a lane to the boundary ahead."""
    lane.position = boundary_hit.position
    lane.exit_offset = Vector(ZERO, ZERO, ZERO)
    lane.previous_direction, lane.previous_length = ray.direction, boundary_hit.distance


@inline_only
def attenuate(lane, distance, features):
    """Attenuate the ray of a lane along a distance in its pore."""
    dry_path = distance
    if features.wet is not None:
        wet_path = select(lane.pore_wet, distance, ZERO)
        dry_path = select(lane.pore_wet, ZERO, distance)
        lane.wet_path += wet_path
        lane.optical_depth += wet_path * lane.wet.material.absorption
    lane.dry_path += dry_path
    lane.optical_depth += dry_path * lane.dry.material.absorption


@inline_only
def store_grain(lane, grain, accepted, features):
    """Store the accepted grain of a lane, if there is one."""
    lane.grain = select(accepted, grain, lane.grain)
    lane.shell, lane.side = select(accepted, ZERO, lane.shell), select(accepted, ONE, lane.side)
    if features.faceted is not None:
        lane.roughness = select(accepted, lane.new_roughness, lane.roughness)
    if features.mixed is not None:
        lane.grain_type = select(accepted, lane.new_type, lane.grain_type)


# --------------------------------------------------------------------------------------------------
# Optical constants of lanes, in their layer and at their grain.


@inline_only
def get_material(optics, item, material):
    """Return the optical constants of a material for a work item in single precision."""
    index = to_single(refractive_index_of(optics, (item, material)))
    return Material(index, single(optics.absorption[item, material]))


@inline_only
def make_pore(optics, item, pore, core):
    """Return the optical constants of a pore material, and of its interfaces with grains."""
    inward = compute_relative_index(optics, item, pore, core)
    outward = compute_relative_index(optics, item, core, pore)
    return Pore(get_material(optics, item, pore), inward, outward)


@inline_only
def set_layer_optics(lane, job):
    """Set the optical constants of a lane in its layer.

    The core is that of the first grain type; in mixed scenes `set_grain_optics` replaces it.
    """
    layers, types, optics, item = job.scene.layers, job.scene.types, job.optics, lane.item
    layer = lane.layer
    grain_type, dry = layers.first_type[layer], layers.first_pore_material[layer]
    core = types.material[grain_type, types.n_shells[grain_type] - 1]
    lane.layer_geometry = to_single(get_layer_geometry(layers, layer))
    lane.wet_fraction, lane.first_type = layers.wet_fraction[layer], grain_type
    lane.dry = make_pore(optics, item, dry, core)
    lane.wet = make_pore(optics, item, dry + WET_PORE, core)
    lane.core = get_material(optics, item, core)


@inline_only
def compute_relative_index(optics, item, near_material, far_material):
    """Return the `RelativeIndex` of two materials, computed in double precision."""
    near = refractive_index_of(optics, (item, near_material))
    far = refractive_index_of(optics, (item, far_material))
    same = near.n == far.n and near.k == far.k
    k = 0.0 if same else far.k / near.n
    m, m_minus_1 = single(far.n / near.n), single((far.n - near.n) / near.n)
    return RelativeIndex(m, m_minus_1, single(k), single(near.n / far.n), same)


@inline_only
def set_grain_optics(lane, job):
    """Set the optical constants of a lane to those of the grain that was hit."""
    types, grain_type = job.scene.types, lane.grain_type
    n_shells = types.n_shells[grain_type]
    lane.core_shell = n_shells
    lane.outer = get_material(job.optics, lane.item, types.material[grain_type, 0])
    lane.core = get_material(job.optics, lane.item, types.material[grain_type, n_shells - 1])
    semi_major = lane.grain.semi_minor / (ONE - lane.grain.flattening)
    lane.coating_thickness = single(2.0 * types.coating_thickness[grain_type, 0]) * semi_major


# --------------------------------------------------------------------------------------------------
# Alignment of arrays and stack frames to cache lines.
#
# A vector that crosses a cache line takes twice the time to load.  Arrays and stack frames of
# compiled functions are aligned to 32 and 16 bytes only.

CACHE_LINE_BYTES = 64
"""Size of a cache line, and of the widest vectors."""


@inline_allocating
def allocate_aligned(count):
    """Return uint32[count] of zeros, aligned to a cache line."""
    words = CACHE_LINE_BYTES // 4
    buffer = np.zeros(count + words, dtype=np.uint32)
    offset = -(buffer.ctypes.data // 4) % words
    return buffer[offset : offset + count]


@intrinsic
def align_stack(typing_context: Any) -> Any:
    """Align the stack frame of the calling function to a cache line."""

    def lower(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        with builder.goto_entry_block():
            slot = builder.alloca(ir.ArrayType(ir.IntType(8), CACHE_LINE_BYTES))
            slot.align = CACHE_LINE_BYTES
        # The empty assembly uses the slot, so that LLVM does not remove it.
        use_type = ir.FunctionType(ir.VoidType(), [slot.type])
        builder.asm(use_type, "", "r", [slot], True)
        return context.get_dummy_value()

    return types.void(), lower
