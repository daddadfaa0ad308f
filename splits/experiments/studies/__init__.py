"""Studies: tables and figures made from several experiments; one class for each kind.

Another kind is a subclass of `splits.experiments.studies.study.Study` in a file of this folder, and
a member of `AnyStudy`.
"""

from typing import Annotated, Any

from pydantic import Discriminator, Tag

from splits.experiments.studies.agreement import AgreementStudy
from splits.experiments.studies.interpretation import InterpretationStudy
from splits.experiments.studies.measured import AnisotropyStudy, SurfaceAreaStudy
from splits.experiments.studies.sand_tables import SandCompositionsStudy, SandTablesStudy
from splits.experiments.studies.sensitivity import SensitivityStudy
from splits.experiments.studies.tables import BandsStudy, SobolStudy
from splits.experiments.studies.trends import AngularTrendsStudy, LayerTrendsStudy


def get_study_kind(content: Any) -> Any:
    """Return the kind of a study."""
    return content.get("kind") if isinstance(content, dict) else getattr(content, "kind", None)


AnyStudy = Annotated[
    Annotated[SensitivityStudy, Tag("sensitivity")]
    | Annotated[AgreementStudy, Tag("agreement")]
    | Annotated[SandTablesStudy, Tag("sand_tables")]
    | Annotated[SandCompositionsStudy, Tag("sand_compositions")]
    | Annotated[AngularTrendsStudy, Tag("angular_trends")]
    | Annotated[LayerTrendsStudy, Tag("layer_trends")]
    | Annotated[InterpretationStudy, Tag("interpretation")]
    | Annotated[SurfaceAreaStudy, Tag("surface_area")]
    | Annotated[SobolStudy, Tag("sobol")]
    | Annotated[BandsStudy, Tag("bands")]
    | Annotated[AnisotropyStudy, Tag("anisotropy")],
    Discriminator(get_study_kind),
]
"""A study of any kind, which the key `kind` determines."""
