"""Studies: tables and figures made from several experiments; one class for each kind.

A further kind is a file of this folder with a subclass of
`splits.experiments.studies.study.Study`.
"""

import importlib
import pkgutil
from collections.abc import Iterator
from functools import reduce
from operator import or_
from typing import Annotated, Any, get_args

from pydantic import Discriminator, Tag

from splits.core.validation import invalid
from splits.experiments.studies.study import Study

for _module in pkgutil.iter_modules(__path__):
    importlib.import_module(f"{__name__}.{_module.name}")


def _iter_kinds(base: type[Study]) -> Iterator[tuple[str, type[Study]]]:
    """Yield the kinds of studies and their classes: those whose key `kind` is a literal."""
    for study in base.__subclasses__():
        kinds = get_args(study.model_fields["kind"].annotation)
        if kinds:
            yield kinds[0], study
        yield from _iter_kinds(study)


def get_study_kind(content: Any) -> Any:
    """Return the kind of a study."""
    return content.get("kind") if isinstance(content, dict) else getattr(content, "kind", None)


def collect_kinds(base: type[Study]) -> dict[str, type[Study]]:
    """Return the classes of studies by kind; reject two classes of a kind."""
    found: dict[str, type[Study]] = {}
    for kind, study in _iter_kinds(base):
        if kind in found:
            hint = f"{found[kind].__name__} has it"
            raise invalid(f"{study.__name__}.kind", kind, "unique", hint)
        found[kind] = study
    return found


STUDY_KINDS = collect_kinds(Study)
"""Classes of studies by kind."""
AnyStudy: Any = Annotated[
    reduce(or_, (Annotated[study, Tag(kind)] for kind, study in STUDY_KINDS.items())),
    Discriminator(get_study_kind),
]
"""A study of any kind, which the key `kind` determines."""
