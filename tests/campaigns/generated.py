"""Hypothesis strategies for the contents of experiment files.

`valid_contents` builds contents from known keys and mostly possible values; module `odd` makes
invalid ones of them.  `to_flow_yaml` writes contents as YAML in flow style, in which any scalar may
stand anywhere.
"""

import json
from typing import Any

from hypothesis import strategies as st

from splits.core.declarations import list_inputs
from splits.experiments.config.media import make_label
from splits.plotting.figure import FIGURES, list_instrument_figures


class RawText(str):
    """Text that is written to a file unchanged."""

    __slots__ = ()


def to_flow_yaml(value: Any) -> str:
    """Return a value as YAML in flow style."""
    if isinstance(value, RawText):
        return str(value)
    if isinstance(value, dict):
        return (
            "{" + ", ".join(f"{to_flow_yaml(k)}: {to_flow_yaml(v)}" for k, v in value.items()) + "}"
        )
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(to_flow_yaml, value)) + "]"
    if isinstance(value, float):
        return repr(value).replace("inf", ".inf").replace("nan", ".nan")
    return json.dumps(value)


def to_file_text(content: Any) -> str:
    """Return the text of a file, with one line per section if there are sections."""
    if not isinstance(content, dict) or not content:
        return to_flow_yaml(content)
    return "".join(
        f"{to_flow_yaml(key)}: {to_flow_yaml(value)}\n" for key, value in content.items()
    )


RARELY = st.sampled_from([False] * 9 + [True])
OFTEN = st.sampled_from([True] * 9 + [False])


# --- media ------------------------------------------------------------------------------------


def numbers_within(low: float, high: float) -> st.SearchStrategy:
    """Return numbers of a range, with its ends and short decimals more often than others."""
    return (
        st.floats(low, high, allow_subnormal=False)
        | st.floats(low, high, allow_subnormal=False).map(lambda x: float(f"{x:.3g}"))
        | st.sampled_from([low, high])
    )


def increasing_numbers(low: float, high: float, count: int = 2) -> st.SearchStrategy:
    return st.lists(numbers_within(low, high), min_size=count, max_size=count, unique=True).map(
        sorted
    )


def optional_keys(**strategies: st.SearchStrategy) -> st.SearchStrategy:
    """Return mappings of some of these keys."""
    return st.fixed_dictionaries({}, optional=strategies)


def limited_normals(low: float, high: float) -> st.SearchStrategy:
    """Return (min, max, mean, sd) of a limited normal."""
    return st.tuples(increasing_numbers(low, high, 3), numbers_within(0.001, 0.5)).map(
        lambda sampled: [sampled[0][0], sampled[0][2], sampled[0][1], sampled[1]]
    )


TABLE = {"wavelength_nm": [200, 100_000], "n": [1.3, 1.4], "k": [1e-9, 1e-3]}
INDEX = (
    numbers_within(1.0, 2.5)
    | st.sampled_from(["1.31+1e-7j", "1.5", "1+1j", "warren_brandt_2008", "nowhere.csv", TABLE])
    | numbers_within(0.1, 10.0).map(
        lambda factor: {"dataset": "warren_brandt_2008", "k_factor": factor}
    )
)
INTERPRETATIONS = optional_keys(
    entry_point=st.sampled_from(["uniform", "projected"]),
    facet_sampling=st.sampled_from(["projected", "unweighted", "any"]),
    wrong_side_ray=st.sampled_from(["cosine_lobe", "mirror"]),
    boundary_fresnel=st.sampled_from(["yes", "no"]),
    mean_free_path=st.sampled_from(["pore_only", "including_grain"]),
    overlap_with_previous_segment=st.sampled_from(["reject", "keep", "skip"]),
    overlap_with_boundary=st.sampled_from(["reject", "keep", "skip"]),
)
FRACTIONS = st.lists(numbers_within(0.0, 1.0), min_size=2, max_size=2).map(
    lambda x: [min(x), max(x) - min(x), 1.0 - max(x)]
)
GROUNDS = numbers_within(0.0, 1.0) | st.sampled_from(
    ["open", "black", "camborthid", {"wavelength_nm": [400, 2500], "albedo": [0.1, 0.6]}]
)
KEYWORDS = {
    "snow": {
        "grain_size_um": increasing_numbers(20.0, 900.0),
        "facetness": limited_normals(0.0, 1.0),
        "sphericity": limited_normals(0.3, 1.0),
        "saturation": numbers_within(0.0, 1.0),
        "density_kg_m3": numbers_within(50.0, 900.0),
        "temperature_c": numbers_within(-40.0, 0.0),
        "depth_m": numbers_within(0.001, 0.02),
        "refractive_index": st.dictionaries(st.sampled_from(["ice", "water"]), INDEX, max_size=2),
        "interpretation": INTERPRETATIONS,
        "ground": GROUNDS,
    },
    "sand": {
        "iron_oxide": numbers_within(0.0, 0.05),
        "hematite_ratio": numbers_within(0.0, 1.0),
        "magnetite": numbers_within(0.0, 0.3),
        "partition": FRACTIONS,
        "texture": numbers_within(0.0, 0.05).map(lambda clay: [clay, clay, 1.0 - 2.0 * clay]),
        "saturation": numbers_within(0.0, 1.0),
        "porosity": numbers_within(0.35, 0.6),
        "roundness": st.tuples(numbers_within(0.0, 1.0), numbers_within(0.001, 0.5)),
        "sphericity": limited_normals(0.3, 1.0),
        "depth_m": numbers_within(0.003, 0.01),
        "refractive_index": st.dictionaries(
            st.sampled_from(["quartz", "hematite", "goethite", "water"]), INDEX, max_size=2
        ),
        "interpretation": INTERPRETATIONS,
        "ground": GROUNDS,
    },
    "particle_layer": {
        "optical_thickness": numbers_within(0.0, 20.0) | st.just(float("inf")),
        "single_scattering_albedo": numbers_within(0.0, 0.99),
        "asymmetry": numbers_within(-0.9, 0.9),
        "refractive_index": numbers_within(1.0, 3.0),
        "ground": numbers_within(0.0, 1.0) | st.sampled_from(["open", "black"]),
        "surface": st.fixed_dictionaries(
            {
                "rms_height_m": numbers_within(1e-3, 0.02),
                "wave_number_per_m": numbers_within(1.0, 50.0),
                "correlation": st.just("gaussian"),
            },
            optional={
                "waves": st.integers(1, 24),
                "band_limit_per_m": numbers_within(50.0, 500.0),
            },
        ),
        "phase_function": st.sampled_from(["henyey_greenstein", "rayleigh"]),
        "polarized": st.booleans(),
        "depolarization": numbers_within(0.0, 0.85),
        "opaque": st.booleans(),
        "depth_m": numbers_within(0.5, 10.0),
    },
}
LAYER_OF_STACK = st.one_of(
    st.fixed_dictionaries(
        {"kind": st.just("snow"), "depth_m": numbers_within(1e-4, 0.01)},
        optional={
            key: KEYWORDS["snow"][key] for key in ("grain_size_um", "density_kg_m3", "saturation")
        },
    ),
    st.fixed_dictionaries(
        {"kind": st.just("sand"), "depth_m": numbers_within(1e-3, 0.005)},
        optional={
            key: KEYWORDS["sand"][key] for key in ("iron_oxide", "partition", "saturation")
        },
    ),
)  # fmt: skip
TOP_LAYER = st.fixed_dictionaries(
    {
        "kind": st.just("particle_layer"),
        "optical_thickness": numbers_within(0.0, 5.0),
        "depth_m": numbers_within(0.1, 1.0),
    },
    optional={
        key: KEYWORDS["particle_layer"][key]
        for key in ("single_scattering_albedo", "asymmetry", "refractive_index", "surface")
    },
)
"""A particle layer; its surface is only valid on top of a stack."""
GRAIN_LAYERS = st.lists(LAYER_OF_STACK, min_size=1, max_size=3)
KEYWORDS["stack"] = {
    "layers": GRAIN_LAYERS
    | st.tuples(TOP_LAYER, GRAIN_LAYERS).map(lambda both: [both[0], *both[1]]),
    "ground": GROUNDS,
}
BASE_FILES = {
    "stack": [],
    "snow": ["splitsnow_table1"],
    "sand": ["splits_base", "tec_10019201", "tec_13j9823"],
    "particle_layer": [],
}

# --- labels, instruments, figures -------------------------------------------------------------

ODD_LABELS = [
    "default", "a b", "Ångström µ", "0.10", "1e3", "yes", "a=b", "λ/2", "100-200", "x" * 60,
    "%d {}", "$x$", "_", "$", r"$\frac$", "a_$b^$", "=1+1", "</script>", "<!-- <script>",
    "*half r_",
]  # fmt: skip
LABELS = st.sampled_from(ODD_LABELS) | st.text(
    st.characters(codec="utf-8", categories=["L", "N", "P"]), min_size=1, max_size=8
)
WAVELENGTHS = st.lists(
    st.integers(400, 2000), min_size=1, max_size=4, unique=True
).map(sorted) | st.fixed_dictionaries(
    {"start": st.just(400), "stop": st.integers(401, 2000), "step": st.integers(100, 500)},
    optional={"also": st.lists(st.integers(400, 2000), max_size=2)},
)  # fmt: skip
AZIMUTHS = st.sampled_from([[0, 180], [0, 90, 180], [0, 45.5, 180, 359]])
SETTINGS = {
    "spectrophotometer": {"estimator": st.sampled_from(["spectral", "analog"])},
    "goniophotometer": {
        "estimator": st.sampled_from(["expansion", "bins", "next_event"]),
        "target": st.sampled_from(["brdf", "btdf"]),
        "polar_deg": increasing_numbers(0.0, 89.0, 3),
        "azimuth_deg": AZIMUTHS,
        "n_bins": st.sampled_from([[2, 4], [6, 8]]),
        "rays": st.integers(1, 5000),
    },
    "beam_spread": {"rays": st.integers(1, 5000), "half_width_m": numbers_within(1e-3, 1.0)},
    "refractive_index": {},
    "surface_map": {"half_width_m": numbers_within(0.1, 10.0), "realizations": st.integers(2, 5)},
    "lens": {
        "radius_m": numbers_within(0.1, 3.0),
        "screen_depth_m": increasing_numbers(0.5, 50.0, 3),
        "half_width_m": numbers_within(1.0, 20.0),
        "centre_on": st.sampled_from(["crest", "trough", "origin"]),
        "realizations": st.integers(1, 3),
        "rays": st.integers(3, 100),
    },
}
INSTRUMENTS_OF_MEDIUM = {
    "stack": ["spectrophotometer", "goniophotometer", "beam_spread", "refractive_index"],
    "snow": ["spectrophotometer", "goniophotometer", "beam_spread", "refractive_index"],
    "sand": ["spectrophotometer", "goniophotometer", "beam_spread", "refractive_index"],
    "particle_layer": [
        "spectrophotometer",
        "goniophotometer",
        "beam_spread",
        "surface_map",
        "lens",
    ],
}
QUANTITIES = {
    "spectrophotometer": ["reflectance", "transmittance", "absorptance"],
    "goniophotometer": ["brdf", "btdf", "reflectance_factor", "anisotropy_factor"],
}


@st.composite
def mediums(draw, kind: str, rough: bool) -> dict[str, Any]:
    medium = draw(optional_keys(**KEYWORDS[kind]))
    if rough and draw(OFTEN):
        medium["surface"] = draw(KEYWORDS["particle_layer"]["surface"])
    if kind == "sand":  # the default of a metre takes minutes without absorption
        medium.setdefault("depth_m", draw(KEYWORDS["sand"]["depth_m"]))
    if kind == "stack":
        medium.setdefault("layers", draw(KEYWORDS["stack"]["layers"]))
    if BASE_FILES[kind] and draw(st.booleans()):
        medium["base"] = draw(st.sampled_from(BASE_FILES[kind]))
    return {"kind": kind, **medium}


@st.composite
def instruments(draw, kind: str, medium_kind: str) -> dict[str, Any]:
    known = SETTINGS[kind]
    always = {
        "surface_map": ["half_width_m"],
        "lens": ["radius_m", "screen_depth_m", "half_width_m"],
    }
    needed = {key: known[key] for key in always.get(kind, [])}
    others = {key: values for key, values in known.items() if key not in needed}
    instrument = draw(st.fixed_dictionaries(needed, optional=others))
    if kind not in ("surface_map", "lens"):
        # Analog absorption traces every wavelength alone, so not the hundreds of the default.
        analog = instrument.get("estimator") == "analog"
        if medium_kind != "snow" or analog or draw(st.booleans()):
            instrument["wavelength_nm"] = draw(WAVELENGTHS)
        if kind != "refractive_index" and draw(st.booleans()):
            diffuse = st.just("diffuse") if kind == "spectrophotometer" else st.nothing()
            instrument["incidence_deg"] = draw(numbers_within(0.0, 89.0) | diffuse)
    if draw(RARELY):
        instrument["seed"] = draw(st.integers(0, 2**31))
    estimator = instrument.get("estimator")
    if estimator == "bins":
        instrument.pop("polar_deg", None)
        instrument.pop("azimuth_deg", None)
    elif draw(OFTEN):
        instrument.pop("n_bins", None)
    return {"kind": kind, **instrument}


@st.composite
def grids(draw, kind: str) -> dict[str, Any]:
    """Return up to two parameters with up to three values, listed or labelled."""
    values = {
        **KEYWORDS[kind],
        "incidence_deg": numbers_within(0.0, 80.0),
        "medium": optional_keys(**KEYWORDS[kind]),
    }
    if kind == "stack":
        values |= {
            "layers.0.depth_m": numbers_within(1e-3, 0.01),
            "layers.1.saturation": numbers_within(0.0, 1.0),
        }
    grid = {}
    for parameter in draw(st.lists(st.sampled_from(sorted(values)), max_size=2, unique=True)):
        given = draw(st.lists(values[parameter], min_size=1, max_size=3))
        named = any(isinstance(value, dict) for value in given)
        if named or draw(st.booleans()):
            names = draw(st.lists(LABELS, min_size=len(given), max_size=len(given), unique=True))
            given = dict(zip(names, given, strict=True))
        grid[parameter] = given
    return grid


@st.composite
def figures(draw, kind: str, grid: dict[str, Any]) -> dict[str, Any]:
    figure = {}
    kinds = [one for one in list_instrument_figures(kind) if one != "season"]
    if draw(st.booleans()):
        figure["kind"] = draw(st.sampled_from(kinds))
    shown = figure.get("kind", kinds[0])
    settings = list_inputs(FIGURES[shown].draw)
    if kind in QUANTITIES and shown in ("spectra", "points", "principal_plane") and draw(OFTEN):
        several = st.lists(st.sampled_from(QUANTITIES[kind]), min_size=1, max_size=3, unique=True)
        figure["quantity"] = draw(several | several.map(lambda names: names[0]))
    for parameter, given in grid.items():
        if shown in ("lobes", "bins", "spread", "surface", "lens") or draw(RARELY):
            labels = [make_label(parameter, v) for v in given] if isinstance(given, list) else given
            figure.setdefault("select", {})[parameter] = draw(st.sampled_from(list(labels)))
    if "legend" in settings and grid and draw(RARELY):
        figure["legend"] = draw(LABELS)
    if "ylim" in settings and draw(RARELY):
        figure["ylim"] = draw(increasing_numbers(0.0, 2.0))
    if shown == "spectra" and draw(RARELY):
        figure["wavelength_nm"] = draw(increasing_numbers(300.0, 2500.0))
        figure["measured"] = draw(
            st.sampled_from(["aviris_ng_varsa2021.csv", "sand_reflectance_jhu.csv", "none.csv"])
        )
    return figure


@st.composite
def valid_contents(draw) -> dict[str, Any]:
    """Return the contents of an experiment file with known keys."""
    kind = draw(st.sampled_from(sorted(KEYWORDS)))
    instrument = draw(st.sampled_from(INSTRUMENTS_OF_MEDIUM[kind]))
    content: dict[str, Any] = {
        "medium": draw(mediums(kind, instrument in ("surface_map", "lens"))),
        "instrument": draw(instruments(instrument, kind)),
    }
    grid = {} if instrument == "refractive_index" else draw(grids(kind))
    # A value that the grid replaces at every point is invalid.
    for parameter in set(grid) - {"layers"}:
        content["medium"].pop(parameter, None)
        if parameter == "incidence_deg":
            content["instrument"].pop(parameter, None)
    content["grid"] = grid
    content["figure"] = draw(figures(instrument, grid))
    for key in ("title", "caption"):
        if draw(RARELY):
            content[key] = draw(LABELS)
    if draw(RARELY):
        content["name"] = draw(st.sampled_from(["mine", "a_1", "simulate", "Mine", "1", "a b"]))
    for key in ("grid", "figure", "instrument"):
        if not content[key] or draw(RARELY):
            del content[key]
    return content
