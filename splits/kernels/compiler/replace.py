"""Named tuples with some fields replaced, in kernels and in Python."""

from __future__ import annotations

from typing import Any

from numba.extending import overload

from splits.kernels.compiler.jit import INLINE_OPTIONS


def replace(value: Any, **changes: Any) -> Any:
    """Return a named tuple with some fields replaced, as `dataclasses.replace` does."""
    return value._replace(**changes)


@overload(replace, strict=False, jit_options=INLINE_OPTIONS)
def _replace_in_kernel(value: Any, **changes: Any) -> Any:
    # Numba has no keyword arguments of unknown names, so the function is written for these ones.
    # It finds the compiled code by the types of all arguments, so the last one carries the names.
    kind = value.instance_class
    arguments = ", ".join(name if name in changes else f"value.{name}" for name in kind._fields)
    parameters = ", ".join(["value", *changes, f"names={' '.join(changes)!r}"])
    scope = {"Kind": kind}
    exec(f"def replace({parameters}):\n    return Kind({arguments})", scope)
    return scope["replace"]
