from splits.io.bird_brdf import save_brdf
from splits.io.netcdf import load
from splits.io.netcdf import save
from .instruments import Progress as Progress
from .instruments import ProgressBar as ProgressBar
from splits.instruments import beam_spread as bssrdf
from .instruments import deep_transmittance as deep_transmittance
from .instruments import goniophotometer as goniophotometer
from .instruments import lens as lens
from splits.instruments import irradiance_profile as profile
from .instruments import single_scattering as single_scattering
from .instruments import spectra as spectra
from .instruments import spectrophotometer as spectrophotometer
from .instruments import surface_map as surface_map
from splits.tables.build import build_table as table
from splits.tables.table import Table
from splits.tables.table import open_table
from splits.media import ParticleLayer as Layer
from splits.media import Interpretation as Readings
from .media import RoughSurface as RoughSurface
from .media import Sand as Sand
from splits.media import SandInterpretation as SandReadings
from .media import Snow as Snow
from .media import Stack as Stack
from splits.analysis.theory.phase_function import phase_function
from splits.analysis.theory.phase_function import with_diffraction
from splits.retrieval.band_selection import select_bands as best_bands
from splits.retrieval.sobol import sobol_indices
from .retrieval.maps import retrieve_map as retrieve_map
from .retrieval.retrieve import retrieve as retrieve
from splits.illumination import Sky
from splits.instruments import albedo
from splits.illumination import hdrf
from splits.illumination import radiation_profile as light_inside
from splits.illumination import sensor_bands as sensor
from splits.illumination import sky
from splits.core.provenance import __version__
